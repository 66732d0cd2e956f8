"""Hours of captures with random faults: none may be lost or wrong, nothing may grow.

    python -m benchmarks.robustness.soak --minutes 60 --tally SOAK.json [--seed N] [--page FILE]

A camera on the wire and a Grbl stage on a serial port, both simulated in a process of their own,
go wrong at random: lost packets, a stream that stalls, a camera that loses power for a while or
is restarted, control taken away, an alarm of the stage, its cable pulled; now and then the disk is
full. The real drivers take session after session; a run that a fault ends is begun again as the
operator would, by the same command. Every other session is taken by a process of its own that is
killed again and again. Whatever was journaled once must be there at the end of the session, its
file unchanged, and its pixels those of the scene at its height. Memory, threads and open files of
this process are read after each session. Figures of several runs add up in the tally.
"""

import argparse
import errno
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from unittest.mock import patch

import numpy as np

from acquisition.bench import BenchConfig, load_bench
from acquisition.errors import DeviceError, DeviceTimeoutError, SessionError, StageAlarmError
from acquisition.session import MANIFEST_NAME, CaptureImages, Session, verify
from benchmarks.harness import environment, environment_line
from benchmarks.robustness.disk_faults import HEADING as DISK_HEADING
from benchmarks.robustness.soak_bench import SENSOR
from benchmarks.robustness.soak_run import ADDRESS, ENDED_BY_FAULT, run_once, soak_config
from hil_mocks.truth import BenchTruth, CameraPose
from simulation.arrays import FloatArray
from standoff.library import open_stage
from standoff.shipped_configs import shipped_config

TARGET = "brick"
"""Has detail everywhere: at another height every pixel has another level."""

DEVIATION_MAX = 1.02
"""Rms of all pixels over what their noise makes of it. Without a fault it is 1 to 0.2 %; a height
that is wrong by 0.1 mm makes 1.026 of it, an exposure that is wrong by 5 % makes 4."""


class _SceneTruth:
    """The scene under the camera of a simulated bench."""

    def __init__(self, config: BenchConfig) -> None:
        self._truth = BenchTruth(config)
        self._expected: dict[tuple[float, float], FloatArray] = {}

    def deviation(self, images: CaptureImages) -> float:
        """Rms of a capture about the scene at its height, in standard deviations of its noise."""
        record = images.record
        exposure_us, gain_db = record.exposure_us or 0.0, record.gain_db or 0.0
        key = record.height_mm, exposure_us
        if key not in self._expected:
            pose = CameraPose(height_mm=record.height_mm)
            light = self._truth.irradiance(TARGET, 0.0, pose)
            self._expected[key] = self._truth.sensor.expected_dn(
                light, exposure_us, gain_db, record.pixel_format
            )
        expected = self._expected[key]
        sensor = self._truth.sensor
        offset_dn2 = sensor.variance_dn2(sensor.black_level_dn, gain_db)
        slope_dn = sensor.variance_dn2(sensor.black_level_dn + 1, gain_db) - offset_dn2
        variance = offset_dn2 + slope_dn * (expected - sensor.black_level_dn)
        square = (images.mean_dn - expected) ** 2 / (variance / record.frames_used)
        return float(np.sqrt(np.mean(square)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Holdings:
    """What this process holds."""

    memory_mb: float
    threads: int
    files: int

    @classmethod
    def now(cls) -> "_Holdings":
        """Ask the kernel."""
        status = Path("/proc/self/status").read_text().splitlines()
        memory_kb = next(line.split()[1] for line in status if line.startswith("VmRSS"))
        return cls(
            memory_mb=int(memory_kb) / 1024,
            threads=len(list(Path("/proc/self/task").iterdir())),
            files=len(list(Path("/proc/self/fd").iterdir())),
        )


@dataclass(slots=True, kw_only=True)
class _Tally:
    """What happened; ``holdings`` are those of the last run, after each session."""

    runs: int = 0
    minutes: float = 0.0
    captures: int = 0
    sessions: int = 0
    lost: int = 0
    wrong: int = 0
    unfinished: int = 0
    largest_deviation: float = 0.0
    unlocked: int = 0
    killed: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    ended_runs: Counter[str] = field(default_factory=Counter)
    holdings: list[_Holdings] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> "_Tally":
        """Read what earlier runs have added up; nothing if there is no file."""
        if not path.exists():
            return cls()
        made = cls(**json.loads(path.read_text(encoding="utf-8")))
        made.faults, made.ended_runs = Counter(made.faults), Counter(made.ended_runs)
        return made

    def write(self, path: Path) -> None:
        """Write it for the next run."""
        document = {one.name: getattr(self, one.name) for one in fields(self)}
        del document["holdings"]
        part = path.with_name(path.name + ".part")
        part.write_text(json.dumps(document, indent=1), encoding="utf-8")
        part.replace(path)

    def page(self) -> str:
        """What happened as Markdown."""
        # The first sessions load and compile what is not loaded yet.
        first = len(self.holdings) // 4
        settled = self.holdings[first:] or self.holdings
        rows = [
            ("resident memory / MB", [h.memory_mb for h in settled]),
            ("threads", [float(h.threads) for h in settled]),
            ("open files", [float(h.files) for h in settled]),
        ]
        lines = [
            "# Soak",
            "",
            "Made by `python -m benchmarks.robustness.soak --tally SOAK.json --page docs/soak.md`, "
            "run after run; what it does is described in `benchmarks/robustness/soak.py`.",
            "",
            f"{environment_line(environment(('numpy', 'PyGObject', 'pyserial')))}.",
            "",
            f"In **{self.minutes:.0f} minutes** ({self.runs} runs): {self.sessions} sessions, "
            f"{self.captures} captures, **{self.lost} lost, {self.wrong} wrong**; "
            f"{sum(self.faults.values())} faults, which ended {sum(self.ended_runs.values())} "
            f"captures, and {self.killed} kills of the capturing process. Each was resumed by the "
            f"same command, {self.unlocked} after `stage unlock`. Faults that the drivers "
            f"corrected themselves ended none. After 40 runs {self.unfinished} sessions were not "
            "complete yet.",
            "",
            "Every capture was compared with the scene at its height: the rms of its pixels "
            f"was at most {self.largest_deviation:.3f} times their noise.",
            "",
            "| fault | times |",
            "| --- | ---: |",
            *(f"| {name} | {count} |" for name, count in sorted(self.faults.items())),
            "",
            "| error that ended a run | times |",
            "| --- | ---: |",
            *(f"| `{name}` | {count} |" for name, count in sorted(self.ended_runs.items())),
            "",
            f"Of the capturing process in the last run, after each session from number {first + 1} "
            "on:",
            "",
            "| | first | last | least | most |",
            "| --- | ---: | ---: | ---: | ---: |",
            *(
                f"| {name} | {v[0]:.0f} | {v[-1]:.0f} | {min(v):.0f} | {max(v):.0f} |"
                for name, v in rows
                if v
            ),
        ]
        return "\n".join(lines) + "\n"


FAULTS: dict[str, tuple[tuple[str, ...], tuple[str, ...], float]] = {
    "packets lost, 2 %": (("fault packet_loss_rate=0.02",), ("fault none",), 3.0),
    "stream stalls": (("fault is_stalled=true",), ("fault none",), 1.5),
    "camera dead for a while": (("fault is_dead=true",), ("restart", "fault none"), 2.0),
    "camera restarted": (("restart",), (), 0.0),
    "control taken away": (("drop-control",), (), 0.0),
    "alarm of the stage": (("alarm",), (), 0.0),
    "stage unplugged": (("unplug",), ("plug-in",), 1.5),
}
"""Lines that begin a fault, lines that end it, and the seconds between."""
PAUSE_S = (3.0, 9.0)
TRIES = 40
"""Runs of one session; a fault cannot last so long."""
KILL_AFTER_S = (6.0, 40.0)
"""Starting and homing take some seconds."""
DISK_FULL_RATE = 0.01
"""Of the calls that make something durable."""


class _FaultyBench:
    """The simulated bench and what goes wrong with it, until closed."""

    def __init__(self, seed: int, tally: _Tally, link: Path) -> None:
        self._random = random.Random(seed)
        self._tally = tally
        self._ending = threading.Event()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.robustness.soak_bench", ADDRESS, str(link)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._answer() != "ready":
            raise RuntimeError("the simulated bench could not be served")
        self._say(f"place {TARGET} 0")
        self._thread = threading.Thread(target=self._go_wrong, name="soak-faults")
        self._thread.start()

    def close(self) -> None:
        """End the faults, then the bench."""
        self._ending.set()
        self._thread.join()
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(30)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _go_wrong(self) -> None:
        while not self._ending.wait(self._random.uniform(*PAUSE_S)):
            name = self._random.choice(list(FAULTS))
            begins, ends, seconds = FAULTS[name]
            self._tally.faults[name] += 1
            for line in begins:
                self._say(line)
            self._ending.wait(seconds)
            for line in ends:
                self._say(line)

    def _say(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        self._answer()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


@contextmanager
def _full_disk_at_times(tally: _Tally) -> Iterator[None]:
    """Let syncing fail now and then as on a full disk."""
    fsync = os.fsync

    def failing(descriptor: int) -> None:
        if random.random() < DISK_FULL_RATE:
            tally.faults["disk full"] += 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    with patch.object(os, "fsync", failing):
        yield


def _stored(folder: Path) -> set[str]:
    """The captures that are journaled so far: none of them may be missing from now on."""
    if not (folder / MANIFEST_NAME).exists():
        return set()
    return {capture.record.uid for capture in Session(folder).captures}


def _take_session(folder: Path, config: BenchConfig, tally: _Tally, promised: set[str]) -> None:
    """Run a session to its end as the operator would."""
    for _ in range(TRIES):
        promised |= _stored(folder)
        try:
            with _full_disk_at_times(tally):
                run_once(folder, config)
        except (DeviceError, SessionError) as error:
            tally.ended_runs[type(error).__name__] += 1
            print(f"  {type(error).__name__}: {error}", flush=True)
            time.sleep(0.5)
            if isinstance(error, StageAlarmError | DeviceTimeoutError):
                _unlock(config, tally)
        else:
            return


def _take_killed_session(
    folder: Path, config: BenchConfig, tally: _Tally, promised: set[str]
) -> None:
    """Let another process run it, and kill that at random moments until it is complete."""
    for _ in range(TRIES):
        promised |= _stored(folder)
        command = [
            sys.executable,
            "-m",
            "benchmarks.robustness.soak_run",
            str(folder),
            str(config.stage.port),
        ]
        process = subprocess.Popen(command)
        try:
            status = process.wait(random.uniform(*KILL_AFTER_S))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            tally.killed += 1
            time.sleep(1.0)  # the camera's heartbeat
            _unlock(config, tally)
            continue
        if status == 0:
            return
        if status != ENDED_BY_FAULT:
            raise RuntimeError(f"a run ended with status {status}")
        tally.ended_runs["in a process of its own"] += 1
        _unlock(config, tally)


def _check_session(folder: Path, truth: _SceneTruth, tally: _Tally, promised: set[str]) -> None:
    """Look whether all that was stored is there and right, and whether the plan is done."""
    session = Session(folder)
    tally.lost += len(promised - _stored(folder)) + (not verify(folder).is_ok)
    tally.unfinished += not session.is_complete
    for record in session.records:
        deviation = truth.deviation(session.load(record))
        tally.largest_deviation = max(tally.largest_deviation, deviation)
        if deviation > DEVIATION_MAX:
            tally.wrong += 1
            print(f"  capture {record.index} of {record.height_mm} mm: {deviation:.3f}", flush=True)
    tally.captures += len(session.records)
    tally.sessions += 1


def _unlock(config: BenchConfig, tally: _Tally) -> None:
    """Do what the message of a stage in alarm asks for: ``standoff stage unlock``."""
    try:
        with closing(open_stage(config.stage, first="reset")) as stage:
            stage.clear_alarm()
        tally.unlocked += 1
    except DeviceError as error:
        print(f"  not unlocked: {error}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tally", type=Path, help="file in which the runs add up")
    parser.add_argument("--page", type=Path, help="write the figures as Markdown")
    given = parser.parse_args()
    tally = _Tally() if given.tally is None else _Tally.read(given.tally)
    random.seed(given.seed)
    truth = _SceneTruth(load_bench(shipped_config("simulated.toml"), SENSOR))
    begun_s, before_minutes = time.monotonic(), tally.minutes
    tally.runs += 1
    folder = Path(tempfile.mkdtemp(prefix="standoff-soak-"))
    bench = _FaultyBench(given.seed + tally.runs, tally, folder / "stage")
    try:
        config = soak_config(str(folder / "stage"))
        while time.monotonic() - begun_s < 60 * given.minutes:
            take = _take_killed_session if tally.sessions % 2 else _take_session
            promised: set[str] = set()
            take(folder / "session", config, tally, promised)
            _check_session(folder / "session", truth, tally, promised)
            shutil.rmtree(folder / "session")
            tally.holdings.append(_Holdings.now())
            tally.minutes = before_minutes + (time.monotonic() - begun_s) / 60
            if given.tally is not None:
                tally.write(given.tally)
            last = tally.holdings[-1]
            print(
                f"{tally.minutes:6.1f} min: {tally.sessions} sessions, {tally.captures} captures, "
                f"{tally.lost} lost, {tally.wrong} wrong, {tally.unfinished} unfinished, "
                f"{tally.killed} kills; "
                f"{last.memory_mb:.1f} MB, {last.threads} threads, {last.files} files",
                flush=True,
            )
    finally:
        bench.close()
        shutil.rmtree(folder)
    page = tally.page()
    print(page)
    if given.page is not None:
        # What other programs measured stands below.
        old = given.page.read_text(encoding="utf-8") if given.page.exists() else ""
        _, heading, rest = old.partition(f"\n{DISK_HEADING}")
        given.page.write_text(f"{page}{heading}{rest}", encoding="utf-8")
    return 1 if tally.lost or tally.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
