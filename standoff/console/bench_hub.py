"""What persists while pages come and go: sessions, their results, and the bench if there is one."""

import shutil
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from acquisition.bench import BenchConfig
from acquisition.errors import DeviceDisconnectedError
from calibration.geometry import DEFAULT_BOARD, CharucoBoard
from standoff.compile_notice import CompileWatch
from standoff.console.camera_service import CameraService
from standoff.console.control_arbiter import ControlArbiter
from standoff.console.devices import BenchDrivers
from standoff.console.focus_sweep import FocusSweepRun
from standoff.console.frames import FrameBroadcaster
from standoff.console.guide import ReferenceShelf
from standoff.console.jobs import JobRunner, PromptQueue, StageStop
from standoff.console.monitors import (
    PictureMonitor,
    PoseMonitor,
    SharpnessMonitor,
    SquarenessMonitor,
    TrackerMaker,
)
from standoff.console.photographs import PHOTOGRAPHS_FOLDER, PhotographInbox
from standoff.console.plans import PlanLibrary
from standoff.console.pose_curves import GivenCurves, PoseCurves
from standoff.console.result_jobs import ResultJobs
from standoff.console.session_library import SNAPSHOTS_FOLDER, SessionLibrary
from standoff.console.session_run import SessionRun
from standoff.console.snapshot_library import SnapshotLibrary
from standoff.console.stage_service import StageService
from standoff.library import login_name

CLOSE_TIMEOUT_S = 10.0
NOTICES = 20
DISK_PERIOD_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """One line for all pages; numbers ascend."""

    number: int
    text: str


class ConsoleHub:
    """Owns sessions, results, photographs that arrive, and who is in control.

    Without a bench this is all of a console. ``curves`` judge poses at first.
    """

    def __init__(self, *, sessions: Path, curves: GivenCurves | None = None) -> None:
        self.sessions = SessionLibrary(sessions)
        self.photographs = PhotographInbox(sessions / PHOTOGRAPHS_FOLDER)
        self.references = ReferenceShelf(sessions, sessions / PHOTOGRAPHS_FOLDER / "guided")
        self.control = ControlArbiter()
        self.jobs = JobRunner(self.tell)
        self.compiling = CompileWatch()
        self.results = ResultJobs(sessions)
        self.curves = PoseCurves(sessions, curves or GivenCurves(), self._judge_by)
        self._lock = Lock()
        self._notices: deque[Notice] = deque(maxlen=NOTICES)
        self._told = 0
        self._disk: tuple[float, int] = (float("-inf"), 0)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """The last lines for all pages, the oldest first."""
        with self._lock:
            return tuple(self._notices)

    @property
    def operator(self) -> str:
        """Name of the operator: whoever is in control, else the login name."""
        return self.control.operator() or login_name()

    def free_bytes(self) -> int:
        """Free bytes on the disk of the sessions, at most two seconds old."""
        asked_s, free = self._disk
        if time.monotonic() - asked_s > DISK_PERIOD_S:
            there = self.sessions.folder.resolve()
            while not there.exists():
                there = there.parent
            free = shutil.disk_usage(there).free
            self._disk = (time.monotonic(), free)
        return free

    def tell(self, text: str) -> None:
        """Show a line on all pages."""
        with self._lock:
            self._told += 1
            self._notices.append(Notice(number=self._told, text=text))

    def start(self) -> None:
        """Begin to work, in threads."""
        self.compiling.start()

    def stop(self) -> int:
        """Stop the current job; returns the stop's number at once, in any thread."""
        job = self.jobs.current
        if job is not None:
            job.ask_stop()
        return 0

    def close(self) -> None:
        """Stop the current job."""
        job = self.jobs.current
        if job is not None:
            self.stop()
            job.ended.wait(CLOSE_TIMEOUT_S)
        self.references.close()

    def _judge_by(self, _: TrackerMaker | None, words: tuple[str, ...]) -> None:
        self.results.judge_by(words)


class BenchHub(ConsoleHub):
    """Owns everything of a bench as well: its devices, the live picture, and the running session.

    The ``board`` under the camera is for levelling it.
    """

    def __init__(
        self,
        bench: BenchConfig,
        drivers: BenchDrivers,
        *,
        sessions: Path,
        plan_folders: tuple[Path, ...] = (),
        curves: GivenCurves | None = None,
        board: CharucoBoard = DEFAULT_BOARD,
    ) -> None:
        self.bench = bench
        self.clock = drivers.clock
        self.frames = FrameBroadcaster()
        self.pose = PoseMonitor(self.frames, None, report=self.tell)
        super().__init__(sessions=sessions, curves=curves)
        self.snapshots = SnapshotLibrary(sessions / SNAPSHOTS_FOLDER)
        self.plans = PlanLibrary(plan_folders)
        self.prompts = PromptQueue(self._check_job)
        self.camera = CameraService(
            drivers.open_camera,
            self.frames,
            report=self.tell,
            return_s=bench.camera.reconnect_timeout_s,
        )
        self.stage = StageService(
            lambda is_again: drivers.open_stage(is_again, self.prompts.ask),
            limits_mm=bench.stage.limits_mm,
        )
        self.stopping = StageStop(self.stage, self.tell)
        self.picture = PictureMonitor(self.frames)
        optics = bench.optics
        self.sharpness = SharpnessMonitor(self.frames, optics.pixel_pitch_um)
        self.squareness = SquarenessMonitor(
            self.frames, board, 1e3 * optics.focal_length_mm / optics.pixel_pitch_um
        )
        self.sweep = FocusSweepRun(bench, self.camera, self.stage, clock=drivers.clock)
        self._monitors = (self.picture, self.pose, self.sharpness, self.squareness)
        self.run = SessionRun(
            bench,
            self.camera,
            self.stage,
            self.prompts,
            drivers=drivers,
        )

    def start(self) -> None:
        """Open the devices and start watching them, in threads."""
        super().start()
        for part in (self.camera, self.stage, *self._monitors):
            part.start()

    def stop(self) -> int:
        """Stop the stage and the current job; returns the stop's number at once, in any thread."""
        job = self.jobs.current
        super().stop()
        return self.stopping.order(job)

    def close(self) -> None:
        """Stop the current job, and release the devices."""
        super().close()
        for part in (*self._monitors, self.camera, self.stage):
            part.close()

    def require_devices(self) -> None:
        """Refuse to begin what needs camera and stage while one of them is not there.

        A camera that was lost a moment ago is not refused: whatever begins waits for it.
        """
        for status, is_there in (
            (self.camera.status, self.camera.is_expected),
            (self.stage.status, self.stage.status.is_ready),
        ):
            if not is_there:
                raise DeviceDisconnectedError(f"{status.text}. {status.remedy}")

    def _judge_by(self, make_tracker: TrackerMaker | None, words: tuple[str, ...]) -> None:
        self.pose.judge_by(make_tracker)
        super()._judge_by(make_tracker, words)

    def _check_job(self) -> None:
        job = self.jobs.current
        if job is not None:
            job.check()
