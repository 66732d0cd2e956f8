"""Hours of captures with random faults: no capture may be lost, nothing may grow.

    python -m benchmarks.soak --minutes 60 [--seed 1] [--page docs/soak.md]

A camera on the wire and a Grbl stage on a serial port, both simulated in a process of their own,
go wrong at random: lost packets, a stream that stalls, a camera that loses power for a while or
is restarted, control taken away, an alarm of the stage, its cable pulled. The real drivers take
session after session; a run that a fault ends is begun again as the operator would, by the same
command. At the end of a session every capture of the plan must be there and its file unchanged.
Memory, threads and open files of the capturing process are read after each session.
"""

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.bench import BenchConfig, BenchDevices, load_bench
from acquisition.capture import RunOperator, run_plan
from acquisition.errors import DeviceError, DeviceTimeoutError, StageAlarmError
from acquisition.plan import CapturePlan, parse_plan
from acquisition.session import Session, verify
from benchmarks.environment import environment, environment_line
from standoff.shipped_configs import shipped_config
from standoff.workflows import open_bench, open_stage

ADDRESS = "127.211.3.1"
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Holdings:
    """What this process holds."""

    memory_mb: float
    threads: int
    files: int

    @classmethod
    def now(cls) -> "Holdings":
        """Ask the kernel."""
        status = Path("/proc/self/status").read_text().splitlines()
        memory_kb = next(line.split()[1] for line in status if line.startswith("VmRSS"))
        return cls(
            memory_mb=int(memory_kb) / 1024,
            threads=len(list(Path("/proc/self/task").iterdir())),
            files=len(list(Path("/proc/self/fd").iterdir())),
        )


@dataclass(slots=True, kw_only=True)
class Tally:
    """What happened."""

    captures: int = 0
    sessions: int = 0
    lost: int = 0
    unlocked: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    ended_runs: Counter[str] = field(default_factory=Counter)
    holdings: list[Holdings] = field(default_factory=list)


class FaultyBench:
    """The simulated bench and what goes wrong with it, until closed."""

    def __init__(self, seed: int, tally: Tally, link: Path) -> None:
        self._random = random.Random(seed)
        self._tally = tally
        self._ending = threading.Event()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.soak_bench", ADDRESS, str(link)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._answer() != "ready":
            raise RuntimeError("the simulated bench could not be served")
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


def soak_plan() -> CapturePlan:
    """Ten captures, each of five frames."""
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "soak",
            "heights_mm": {"start": 300.0, "stop": 304.0, "step": 1.0},
            "frames_per_capture": 5,
            "targets": [{"kind": "edge", "target": "edge", "orientations_deg": [5.0, 95.0]}],
        },
        source="soak",
    )


def soak_config(port: str) -> BenchConfig:
    """The shipped Grbl bench on the simulated one."""
    return load_bench(
        shipped_config("grbl_stage.toml"),
        {
            "camera.address": ADDRESS,
            "stage.port": port,
            "stage.feed_mm_per_min": 2400,
            "stage.settle_s": 0.05,
            "stage.park_mm": 320,
        },
    )


def take_session(folder: Path, config: BenchConfig, plan: CapturePlan, tally: Tally) -> None:
    """Run a session to its end as the operator would, and look whether all of it is there."""
    for _ in range(TRIES):
        try:
            with open_bench(config) as devices:
                run_plan(
                    folder,
                    plan,
                    BenchDevices(config=config, camera=devices.camera, stage=devices.stage),
                    RunOperator(name="soak", place=lambda _: "ready"),
                )
            break
        except DeviceError as error:
            tally.ended_runs[type(error).__name__] += 1
            print(f"  {type(error).__name__}: {error}", flush=True)
            time.sleep(0.5)
            if isinstance(error, StageAlarmError | DeviceTimeoutError):
                unlock(config, tally)
    session = Session(folder)
    wanted = {entry.index for entry in session.entries}
    kept = {record.index for record in session.records}
    tally.lost += len(wanted - kept) + (not verify(folder).is_ok)
    tally.captures += len(kept)
    tally.sessions += 1


def unlock(config: BenchConfig, tally: Tally) -> None:
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
    parser.add_argument("--page", type=Path, help="write the figures as Markdown")
    given = parser.parse_args()
    tally, plan = Tally(), soak_plan()
    begun_s = time.monotonic()
    folder = Path(tempfile.mkdtemp(prefix="standoff-soak-"))
    bench = FaultyBench(given.seed, tally, folder / "stage")
    try:
        config = soak_config(str(folder / "stage"))
        while time.monotonic() - begun_s < 60 * given.minutes:
            take_session(folder / "session", config, plan, tally)
            shutil.rmtree(folder / "session")
            tally.holdings.append(Holdings.now())
            last = tally.holdings[-1]
            print(
                f"{time.monotonic() - begun_s:6.0f} s: {tally.sessions} sessions, "
                f"{tally.captures} captures, {tally.lost} lost; {last.memory_mb:.1f} MB, "
                f"{last.threads} threads, {last.files} files",
                flush=True,
            )
    finally:
        bench.close()
        shutil.rmtree(folder)
    page = soak_page(tally, (time.monotonic() - begun_s) / 60)
    print(page)
    if given.page is not None:
        given.page.write_text(page, encoding="utf-8")
    return 1 if tally.lost else 0


def soak_page(tally: Tally, minutes: float) -> str:
    """Write what happened as Markdown."""
    # The first sessions load and compile what is not loaded yet.
    settled = tally.holdings[len(tally.holdings) // 4 :] or tally.holdings
    rows = [
        ("resident memory / MB", [h.memory_mb for h in settled]),
        ("threads", [float(h.threads) for h in settled]),
        ("open files", [float(h.files) for h in settled]),
    ]
    lines = [
        "# Soak",
        "",
        "Made by `python -m benchmarks.soak --page docs/soak.md`; what it does is described in "
        "`benchmarks/soak.py`.",
        "",
        f"{environment_line(environment(('numpy', 'PyGObject', 'pyserial')))}.",
        "",
        f"In **{minutes:.0f} minutes**: {tally.sessions} sessions, {tally.captures} captures, "
        f"**{tally.lost} lost**; {sum(tally.faults.values())} faults, which ended "
        f"{sum(tally.ended_runs.values())} runs, each resumed by the same command, "
        f"{tally.unlocked} after `stage unlock`. Faults that the drivers corrected themselves "
        "ended none.",
        "",
        "| fault | times |",
        "| --- | ---: |",
        *(f"| {name} | {count} |" for name, count in sorted(tally.faults.items())),
        "",
        "| error that ended a run | times |",
        "| --- | ---: |",
        *(f"| `{name}` | {count} |" for name, count in sorted(tally.ended_runs.items())),
        "",
        f"Of the capturing process, after each session from number {len(tally.holdings) // 4 + 1} "
        "on:",
        "",
        "| | first | last | least | most |",
        "| --- | ---: | ---: | ---: | ---: |",
        *(
            f"| {name} | {v[0]:.0f} | {v[-1]:.0f} | {min(v):.0f} | {max(v):.0f} |"
            for name, v in rows
        ),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
