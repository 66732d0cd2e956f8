"""Go or no-go: whether the camera's pose lets a follow-up be compared with a chosen reference."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Event, Lock, Thread

import numpy as np

from analysis.pose import PoseTracker, PoseVerdict
from calibration.errors import CalibrationError
from simulation.arrays import AnyArray
from standoff.console.devices.frame_broadcaster import FrameBroadcaster
from standoff.console.devices.reference_picture import ReferencePicture, reference_numbers
from standoff.errors import ApplicationError

TrackerMaker = Callable[[AnyArray], PoseTracker]
"""Makes the tracker of a reference image of shape ``(rows, cols)``."""


PERIOD_S = 0.1
"""At most ten verdicts per second; a search of the whole frame takes longer."""

STALE_S = 2.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseView:
    """The current pose; ``picture`` is the reference, None if none is chosen.

    ``is_possible`` is False if there is no curve to judge by, ``fault`` says why there is no
    verdict though there is one. ``arrived_s`` is when the frame of the verdict arrived (monotonic);
    ``is_searching`` says that the pose was lost since, and the whole of a newer frame is searched.
    """

    is_possible: bool
    picture: ReferencePicture | None = None
    fault: str = ""
    verdict: PoseVerdict | None = None
    arrived_s: float | None = None
    is_searching: bool = False

    @property
    def reference(self) -> str:
        """Name of the reference; empty if none is chosen."""
        return "" if self.picture is None else self.picture.name


class PoseMonitor:
    """Tracks the pose in its own thread, as fast as it can, once a reference is chosen.

    Without a curve to judge by, it keeps the reference and gives no verdict.

    Parameters
    ----------
    broadcaster
        Source of the frames.
    make_tracker
        None if no detectability curve says what is good enough.
    report
        Called with one line when tracking ends by itself.
    """

    def __init__(
        self,
        broadcaster: FrameBroadcaster,
        make_tracker: TrackerMaker | None,
        *,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._broadcaster = broadcaster
        self._report = report
        self._make = make_tracker
        self._lock = Lock()
        self._numbers = reference_numbers()
        self._tracker: PoseTracker | None = None
        self._view = PoseView(is_possible=make_tracker is not None)
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="pose monitor", daemon=True)

    @property
    def view(self) -> PoseView:
        """The current pose."""
        view, tracker = self._view, self._tracker
        return view if tracker is None else replace(view, is_searching=tracker.is_searching)

    def choose(self, name: str, image: AnyArray, max_level_dn: float | None = None) -> None:
        """Compare the pose with this image from now on.

        Parameters
        ----------
        name
            What the image is, for the operator.
        image
            Shape ``(rows, cols)``, in DN.
        max_level_dn
            Level of a saturated pixel; None takes the largest there is.

        Raises
        ------
        ApplicationError
            If there is a curve to judge by, and the image has too little texture.
        """
        try:
            tracker = None if self._make is None else self._make(image)
        except CalibrationError as error:
            raise ApplicationError(f"{name} cannot be used as a reference: {error}") from error
        most_dn = float(np.nanmax(image)) if max_level_dn is None else max_level_dn
        picture = ReferencePicture(
            number=next(self._numbers), name=name, image_dn=image, max_level_dn=max(most_dn, 1.0)
        )
        with self._lock:
            self._tracker = tracker
            self._view = PoseView(is_possible=self._make is not None, picture=picture)

    def judge_by(self, make_tracker: TrackerMaker | None) -> None:
        """Judge by another curve or threshold from now on, or by none; the reference stays."""
        picture, tracker, fault = self._view.picture, None, ""
        if picture is not None and make_tracker is not None:
            try:
                tracker = make_tracker(picture.image_dn)
            except CalibrationError as error:
                fault = f"this reference cannot be followed: {error}"
        with self._lock:
            self._make = make_tracker
            self._tracker = tracker
            self._view = PoseView(
                is_possible=make_tracker is not None, picture=picture, fault=fault
            )

    def clear(self) -> None:
        """Forget the reference."""
        with self._lock:
            self._tracker = None
            self._view = PoseView(is_possible=self._make is not None)

    def start(self) -> None:
        """Start tracking, in a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        seen = 0
        while not self._is_closing.wait(PERIOD_S):
            with self._lock:
                tracker, view = self._tracker, self._view
            if tracker is None:
                continue
            frame = self._broadcaster.wait_newer(seen, STALE_S)
            verdict = None
            if frame is not None:
                seen = frame.sequence
                try:
                    verdict = tracker.update(frame.image_dn)
                except ValueError as error:  # the frame size changed
                    self._report(f"The pose is no longer judged: {error}")
                    self.clear()
                    continue
            with self._lock:
                if tracker is self._tracker:
                    self._view = replace(
                        view,
                        verdict=verdict,
                        arrived_s=None if frame is None else frame.arrived_s,
                    )
