"""Who holds control: one viewer at a time, the others watch; taking it over is explicit."""

from dataclasses import dataclass
from threading import Lock


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlView:
    """Control as one viewer sees it.

    ``holder`` is a name, empty where nobody holds control; ``is_away`` says that the holder's
    page is not connected now.
    """

    is_mine: bool
    holder: str
    is_away: bool
    viewers: int


class ControlArbiter:
    """Keeps who is there and who holds control; a page that is lost keeps what it held."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._present: dict[str, str] = {}
        self._holder: str | None = None
        self._holder_name = ""

    def join(self, viewer: str, name: str) -> None:
        """A page is connected; the first one where nobody holds control is given it."""
        with self._lock:
            self._present[viewer] = name
            if self._holder is None:
                self._hold(viewer)

    def leave(self, viewer: str) -> None:
        """A page is gone; control stays where it was until somebody takes it."""
        with self._lock:
            self._present.pop(viewer, None)

    def take(self, viewer: str) -> None:
        """Take control over, from whoever holds it."""
        with self._lock:
            if viewer in self._present:
                self._hold(viewer)

    def release(self, viewer: str) -> None:
        """Give control away; nobody holds it then."""
        with self._lock:
            if self._holder == viewer:
                self._holder, self._holder_name = None, ""

    def is_holder(self, viewer: str) -> bool:
        """Whether this page holds control."""
        return self._holder == viewer

    def operator(self) -> str:
        """Name of whoever holds control; empty if nobody does."""
        return self._holder_name

    def view(self, viewer: str) -> ControlView:
        """Control as a page sees it."""
        with self._lock:
            return ControlView(
                is_mine=self._holder == viewer,
                holder=self._holder_name,
                is_away=self._holder is not None and self._holder not in self._present,
                viewers=len(self._present),
            )

    def _hold(self, viewer: str) -> None:
        self._holder, self._holder_name = viewer, self._present[viewer]
