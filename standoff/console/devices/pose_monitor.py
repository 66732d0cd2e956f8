"""Go or no-go: whether the camera's pose lets a follow-up be compared with a chosen reference."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, Lock, Thread

from analysis.pose import PoseTracker, PoseVerdict
from calibration.errors import CalibrationError
from simulation.arrays import AnyArray
from standoff.console.devices.frame_broadcaster import FrameBroadcaster
from standoff.errors import ApplicationError

TrackerMaker = Callable[[AnyArray], PoseTracker]
"""Makes the tracker of a reference image of shape ``(rows, cols)``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCurve:
    """The curve of detectability that judges poses.

    ``make_tracker`` makes a tracker that judges by it, ``words`` are the options of
    ``standoff pose`` that name it.
    """

    make_tracker: TrackerMaker
    words: tuple[str, ...] = ()


PERIOD_S = 0.1
"""At most ten verdicts per second; a search of the whole frame takes longer."""

STALE_S = 2.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseView:
    """The current pose: ``reference`` names the reference, empty if none is chosen.

    ``is_possible`` is False if the console was started without curves. ``arrived_s`` is when the
    frame of the verdict arrived (monotonic).
    """

    is_possible: bool
    reference: str = ""
    verdict: PoseVerdict | None = None
    arrived_s: float | None = None


class PoseMonitor:
    """Tracks the pose in its own thread, as fast as it can, once a reference is chosen.

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
        self._tracker: PoseTracker | None = None
        self._view = PoseView(is_possible=make_tracker is not None)
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="pose monitor", daemon=True)

    @property
    def view(self) -> PoseView:
        """The current pose."""
        return self._view

    def choose(self, name: str, image: AnyArray) -> None:
        """Judge the pose against this image from now on.

        Raises
        ------
        ApplicationError
            If there is no curve to judge by, or the image has too little texture.
        """
        if self._make is None:
            raise ApplicationError(
                "no curve says which pose is good enough: start the console with "
                "--curves curves.json --min-dprime D"
            )
        try:
            tracker = self._make(image)
        except CalibrationError as error:
            raise ApplicationError(f"{name} cannot be used as a reference: {error}") from error
        with self._lock:
            self._tracker = tracker
            self._view = PoseView(is_possible=True, reference=name)

    def clear(self) -> None:
        """Stop judging the pose."""
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
                    self._view = PoseView(
                        is_possible=True,
                        reference=view.reference,
                        verdict=verdict,
                        arrived_s=None if frame is None else frame.arrived_s,
                    )
