"""Whether the camera looks squarely at a board: its tilt, live, and which side to raise."""

from dataclasses import dataclass
from threading import Event, Lock, Thread

from calibration.errors import CalibrationError
from calibration.geometry import CharucoBoard, Levelling, find_board, level_by_board
from standoff.console.devices.frame_broadcaster import FrameBroadcaster, LiveFrame

PERIOD_S = 0.2
IDLE_S = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class SquarenessView:
    """The tilt of the newest frame, or why there is none; ``is_wanted`` says that it is watched.

    ``arrived_s`` is when the frame arrived (monotonic).
    """

    is_wanted: bool = False
    levelling: Levelling | None = None
    why_not: str = ""
    arrived_s: float | None = None


class SquarenessMonitor:
    """Looks for a ChArUco board in the newest frame, in its own thread, while it is wanted.

    Parameters
    ----------
    broadcaster
        Source of the frames.
    board
        The board that lies under the camera.
    focal_length_px
        Focal length over pixel pitch.
    """

    def __init__(
        self, broadcaster: FrameBroadcaster, board: CharucoBoard, focal_length_px: float
    ) -> None:
        self._broadcaster = broadcaster
        self._board = board
        self._focal_px = focal_length_px
        self._lock = Lock()
        self._view = SquarenessView()
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="squareness monitor", daemon=True)

    @property
    def view(self) -> SquarenessView:
        """The newest tilt."""
        return self._view

    def watch(self, is_wanted: bool) -> None:
        """Measure the tilt, or stop it."""
        with self._lock:
            self._view = SquarenessView(is_wanted=is_wanted)

    def start(self) -> None:
        """Start measuring, in a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join()

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        rows, cols = frame.image_dn.shape
        levelling, why_not = None, ""
        try:
            corners = find_board(frame.image_dn, self._board)
            levelling = level_by_board(corners, (rows, cols), self._focal_px)
        except (CalibrationError, ValueError) as error:
            why_not = str(error)
        with self._lock:
            if self._view.is_wanted:
                self._view = SquarenessView(
                    is_wanted=True,
                    levelling=levelling,
                    why_not=why_not,
                    arrived_s=frame.arrived_s,
                )

    def _run(self) -> None:
        seen = 0
        while not self._is_closing.wait(PERIOD_S if self._view.is_wanted else IDLE_S):
            if not self._view.is_wanted:
                continue
            frame = self._broadcaster.wait_newer(seen, IDLE_S)
            if frame is not None:
                seen = frame.sequence
                self.look(frame)
