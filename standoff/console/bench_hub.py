"""The bench as the console knows it: devices, picture, session; it outlives every page."""

import getpass
import shutil
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock, Thread

from acquisition.bench import BenchConfig
from acquisition.capture import Placement
from acquisition.devices import Camera, Stage
from acquisition.errors import DeviceError
from acquisition.plan import PlanEntry
from standoff.console.devices import (
    CameraKeeper,
    FrameBoard,
    PictureWatch,
    PoseWatch,
    StageKeeper,
    TrackerMaker,
)
from standoff.console.jobs import ControlDesk, JobDesk, PromptBoard, SessionRun
from standoff.console.plan_library import PlanLibrary
from standoff.console.session_library import SessionLibrary

__all__ = ["BenchDrivers", "BenchHub", "Notice"]

STOP_AGAIN_S = 0.3
STOP_TRIES = 100
"""A stop is repeated until the job has ended: it may come between two moves."""

CLOSE_TIMEOUT_S = 10.0
NOTICES = 20
DISK_PERIOD_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchDrivers:
    """How the devices of a bench are opened.

    Parameters
    ----------
    open_camera
        Opens and configures the camera.
    open_stage
        Opens the stage; its argument says that it was open before and may still move. The
        second one puts a question to whoever moves a manual stage.
    laid
        Lays a target by itself, on a bench simulated in this process; else None.
    clock, sleep
        Seconds in which the devices live, and what lets some pass.
    """

    open_camera: Callable[[], Camera]
    open_stage: Callable[[bool, Callable[[str], str]], Stage]
    laid: Callable[[PlanEntry], Placement] | None = None
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """One line for everybody; numbers ascend."""

    number: int
    text: str


class BenchHub:
    """Owns everything that lives on while pages come and go.

    Parameters
    ----------
    bench
        The bench file.
    drivers
        Open its devices.
    sessions
        Folder of the sessions.
    plan_folders
        Where plans are looked for.
    make_tracker
        For the pose; None where no curve was given.
    """

    def __init__(
        self,
        bench: BenchConfig,
        drivers: BenchDrivers,
        *,
        sessions: Path,
        plan_folders: tuple[Path, ...] = (),
        make_tracker: TrackerMaker | None = None,
    ) -> None:
        self.bench = bench
        self.sessions = SessionLibrary(sessions)
        self.plans = PlanLibrary(plan_folders)
        self.control = ControlDesk()
        self.jobs = JobDesk(self.tell)
        self.prompts = PromptBoard(self._check_job)
        self.board = FrameBoard()
        self.camera = CameraKeeper(drivers.open_camera, self.board, report=self.tell)
        self.stage = StageKeeper(
            lambda is_again: drivers.open_stage(is_again, self.prompts.ask),
            limits_mm=bench.stage.limits_mm,
        )
        self.picture = PictureWatch(self.board)
        self.pose = PoseWatch(self.board, make_tracker, report=self.tell)
        self.run = SessionRun(
            bench,
            self.camera,
            self.stage,
            self.prompts,
            laid=drivers.laid,
            clock=drivers.clock,
            sleep=drivers.sleep,
        )
        self._lock = Lock()
        self._notices: deque[Notice] = deque(maxlen=NOTICES)
        self._told = 0
        self._disk: tuple[float, int] = (float("-inf"), 0)
        self._is_closing = Event()

    @property
    def notices(self) -> tuple[Notice, ...]:
        """The last lines for everybody, the oldest first."""
        with self._lock:
            return tuple(self._notices)

    @property
    def operator(self) -> str:
        """Who captures: whoever holds control, else the login name."""
        return self.control.operator() or getpass.getuser()

    def free_bytes(self) -> int:
        """Room on the disk of the sessions, at most two seconds old."""
        asked_s, free = self._disk
        if time.monotonic() - asked_s > DISK_PERIOD_S:
            there = self.sessions.folder.resolve()
            while not there.exists():
                there = there.parent
            free = shutil.disk_usage(there).free
            self._disk = (time.monotonic(), free)
        return free

    def tell(self, text: str) -> None:
        """Tell everybody something."""
        with self._lock:
            self._told += 1
            self._notices.append(Notice(number=self._told, text=text))

    def start(self) -> None:
        """Open the devices and begin to watch, in threads."""
        for part in (self.camera, self.stage, self.picture, self.pose):
            part.start()

    def stop(self) -> None:
        """Stop the stage and what is going on; returns at once, from any thread."""
        job = self.jobs.current
        if job is not None:
            job.ask_stop()
        Thread(target=self._stop_stage, name="stop", daemon=True).start()

    def close(self) -> None:
        """Stop what is going on, and give the devices back."""
        job = self.jobs.current
        if job is not None:
            self.stop()
            job.ended.wait(CLOSE_TIMEOUT_S)
        for part in (self.pose, self.picture, self.camera, self.stage):
            part.close()

    def _stop_stage(self) -> None:
        job = self.jobs.current
        told: str | None = None
        for _ in range(STOP_TRIES):
            try:
                self.stage.stop()
            except DeviceError as error:
                if str(error) != told:
                    told = str(error)
                    self.tell(f"STOP: {error}")
            if job is None or job.ended.wait(STOP_AGAIN_S):
                return

    def _check_job(self) -> None:
        job = self.jobs.current
        if job is not None:
            job.check()
