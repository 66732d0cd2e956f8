"""Which target is in place, so that a run that is resumed does not ask for it again."""

from collections.abc import Callable
from pathlib import Path
from threading import Lock

from acquisition.capture import Placement
from acquisition.plan import PlanEntry
from acquisition.session import MANIFEST_NAME, Session

Target = tuple[str, str, float]
"""Kind, name and orientation, as in `PlanEntry.placement`."""


class PlacementMemory:
    """Remembers what the operator placed for a session, and how sure that still is.

    The operator's word in this process is taken until somebody stops the run, retakes a capture or
    says that the target was moved: losing a camera or a stage moves no target. What only the
    journal tells, after a restart, is asked for once more, as is anything after a stop.

    Parameters
    ----------
    ask
        Asks to place a target.
    confirm
        Asks whether a target is still in place.
    """

    def __init__(
        self,
        ask: Callable[[PlanEntry], Placement],
        confirm: Callable[[PlanEntry], Placement],
    ) -> None:
        self._ask = ask
        self._confirm = confirm
        self._lock = Lock()
        self._session: Path | None = None
        self._placed: Target | None = None
        self._is_sure = False

    @property
    def placed(self) -> Target | None:
        """What is in place, as far as anybody said; None if nobody did."""
        return self._placed

    def begin(self, session: Path) -> None:
        """Note which session runs; of another one than before, its journal is asked.

        Raises
        ------
        SessionError
            If there is a session that cannot be read.
        """
        if session == self._session:
            return
        captures = Session(session).captures if (session / MANIFEST_NAME).is_file() else ()
        record = captures[-1].record if captures else None
        with self._lock:
            self._session, self._is_sure = session, False
            self._placed = (
                None if record is None else (record.kind, record.target, record.orientation_deg)
            )

    def place(self, entry: PlanEntry) -> tuple[Placement, bool]:
        """Have a target placed; return the answer, and whether anybody was asked."""
        if entry.placement == self._placed and self._is_sure:
            return "ready", False
        asked = self._confirm if entry.placement == self._placed else self._ask
        placement = asked(entry)
        with self._lock:
            is_ready = placement == "ready"
            self._placed, self._is_sure = (entry.placement, True) if is_ready else (None, False)
        return placement, True

    def doubt(self) -> None:
        """Ask before the next capture whether the target is still in place."""
        self._is_sure = False

    def forget(self) -> None:
        """Ask to place the target before the next capture: it was moved."""
        with self._lock:
            self._placed, self._is_sure = None, False
