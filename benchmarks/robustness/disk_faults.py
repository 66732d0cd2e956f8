"""A session on a disk that fills up, turns read-only or has a quota; a wrong clock; two writers.

    sudo python -m benchmarks.robustness.disk_faults [--quick] [--page docs/soak.md]

Each try runs ``standoff capture`` as a user does, on an ext4 file system of its own in a file
(which takes root), and spoils the disk or the clock after some captures. Counted are the runs that
ended in one printable line with status 1, the captures that were journaled by then, and those of
them that are there with the same bytes after the same command has ended the session on a sound
disk. The kernel's own error handling makes the file system read-only. Quota and wall clock are
answered by ``disk_faults.c``, preloaded: not every kernel has quota formats, and the clock is the
whole machine's.
"""

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from acquisition.session import Session, verify
from benchmarks.harness import environment, environment_line
from standoff.shipped_configs import shipped_config

DISK_BYTES = 160 * 2**20
CAPTURES = 30
PLAN = """
schema = "standoff.plan/1"
name = "faults"
heights_mm = {start = 300.0, stop = 309.0, step = 1.0}
frames_per_capture = 2
repeats = 3

[[targets]]
kind = "texture"
target = "brick"
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Where a try happens: the session, and the files that steer the preloaded library."""

    session: Path
    work: Path

    @property
    def quota(self) -> Path:
        """Number of bytes that may still be written."""
        return self.work / "quota"

    @property
    def clock(self) -> Path:
        """Seconds by which the clock is wrong."""
        return self.work / "clock"

    def start(self, *words: object) -> subprocess.Popen[str]:
        """Start the capture command, or another."""
        keys = ("--set", "simulated.width_px=160", "--set", "simulated.height_px=120")
        given = words or (
            "capture", "--bench", shipped_config("simulated.toml"), "--plan",
            self.work / "plan.toml", "--out", self.session, "--yes", *keys,
        )  # fmt: skip
        steered = {
            "LD_PRELOAD": str(self.work / "faults.so"),
            "FAULT_UNDER": str(self.session.parent),
            "FAULT_QUOTA": str(self.quota),
            "FAULT_CLOCK": str(self.clock),
        }
        return subprocess.Popen(
            [sys.executable, "-m", "standoff", *map(str, given)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | steered,
        )

    def captured(self) -> int:
        """Captures in the journal so far."""
        try:
            return (self.session / "journal.jsonl").read_bytes().count(b'"event": "capture"')
        except OSError:
            return 0


class _Disk:
    """An ext4 file system in a file."""

    def __init__(self, work: Path) -> None:
        self._image = work / "disk.img"
        self.folder = work / "disk"
        self.folder.mkdir()
        with self._image.open("wb") as file:
            file.truncate(DISK_BYTES)
        _run("mkfs.ext4", "-q", "-m", "0", str(self._image))
        self._mount()

    def leave(self, free_bytes: int) -> None:
        """Take all space but ``free_bytes``, at once."""
        with (self.folder / "filler").open("ab") as file:
            while (taken := os.statvfs(self.folder)).f_bavail * taken.f_frsize > free_bytes:
                size = max(taken.f_bavail * taken.f_frsize - free_bytes, 1)
                try:
                    os.posix_fallocate(file.fileno(), file.seek(0, os.SEEK_END), size)
                except OSError:
                    # Metadata takes a few blocks: what is left is less than asked for.
                    file.truncate(file.seek(0, os.SEEK_END) + 4096)
                    break

    def free(self) -> None:
        """Give the space back."""
        (self.folder / "filler").unlink(missing_ok=True)

    def break_down(self) -> None:
        """Report an error of the disk to the kernel, which makes the file system read-only."""
        source = subprocess.check_output(
            ["findmnt", "--noheadings", "--output", "SOURCE", str(self.folder)], text=True
        )
        Path("/sys/fs/ext4", Path(source.strip()).name, "trigger_fs_error").write_text("1")

    def mend(self) -> None:
        """Check the file system and mount it again."""
        _run("umount", str(self.folder))
        subprocess.run(["e2fsck", "-fy", str(self._image)], capture_output=True, check=False)
        self._mount()

    def mount_read_only(self) -> None:
        """Refuse writes from now on."""
        _run("mount", "-o", "remount,ro", str(self.folder))

    def close(self) -> None:
        """Unmount it."""
        _run("umount", str(self.folder))

    def _mount(self) -> None:
        _run("mount", "-o", "loop,errors=remount-ro", str(self._image), str(self.folder))


def _run(*words: str) -> None:
    """Run a system's command."""
    subprocess.run(words, check=True, capture_output=True)


HEADING = "## Disk, clock and two writers"
LEFT_BYTES = (0, 40_000, 200_000)
"""Left on the disk or of the quota: nothing, a part of a capture, and one capture and a part."""
DAY_S = 86_400
POLL_S = 0.002
LIMIT_S = 300.0

Spoil = Callable[[], None]


@dataclass(slots=True, kw_only=True)
class _Tally:
    """What became of the tries of one fault."""

    name: str
    tries: int = 0
    told: int = 0
    kept: list[int] = field(default_factory=list)
    lost: int = 0
    damaged: int = 0
    completed: int = 0
    messages: set[str] = field(default_factory=set)

    def row(self) -> str:
        """One row of the table."""
        kept = f"{min(self.kept)} to {max(self.kept)}" if self.kept else ""
        return (
            f"| {self.name} | {self.tries} | {self.told} | {kept} | {self.lost} | {self.damaged} "
            f"| {self.completed} |"
        )


@contextmanager
def _workshop() -> Iterator[tuple[_Disk, Path]]:
    """Make a disk, a plan and the preloaded library, and remove them afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "plan.toml").write_text(PLAN)
        source = Path(__file__).with_suffix(".c")
        _run("cc", "-O2", "-shared", "-fPIC", "-o", str(work / "faults.so"), str(source))
        disk = _Disk(work)
        try:
            yield disk, work
        finally:
            disk.close()


def _spoil_after(
    place: _Place, process: subprocess.Popen[str], captures: int, spoil: Spoil
) -> None:
    """Wait until so many captures are journaled, then spoil the disk or the clock."""
    end_s = time.monotonic() + LIMIT_S
    while place.captured() < captures and process.poll() is None:
        if time.monotonic() > end_s:
            raise TimeoutError(f"no {captures} captures")
        time.sleep(POLL_S)
    if process.poll() is None:
        spoil()


def _is_told(process: subprocess.Popen[str], messages: set[str], place: _Place) -> bool:
    """Whether a command ended with status 1 and one printable line; the line is kept."""
    _, errors = process.communicate(timeout=LIMIT_S)
    lines = [line for line in errors.splitlines() if line.startswith("standoff: ")]
    for line in lines:
        messages.add(line.replace(str(place.session), "SESSION").replace(str(place.work), ""))
    is_clean = "Traceback" not in errors and len(lines) == 1 and lines[0].isprintable()
    return process.returncode == 1 and is_clean


def _held(session: Path) -> dict[str, str]:
    """What was promised: the captures of the journal with the digest of the bytes of each file."""
    return {
        capture.record.uid: hashlib.sha256((session / capture.record.file).read_bytes()).hexdigest()
        for capture in Session(session).captures
    }


def _is_sound(session: Path) -> bool:
    """Whether nothing is wrong with a session."""
    return verify(session).is_ok


def _finish(place: _Place, tally: _Tally, before: dict[str, str]) -> None:
    """Run the same command again on a sound disk, and compare with what there was before."""
    with place.start() as process:
        process.communicate(timeout=LIMIT_S)
    after = _held(place.session)
    tally.lost += sum(after.get(uid) != digest for uid, digest in before.items())
    tally.completed += (
        process.returncode == 0 and Session(place.session).is_complete and _is_sound(place.session)
    )


def _spoiled_in_mid_session(
    place: _Place, tally: _Tally, captures: int, spoil: Spoil, mend: Spoil
) -> None:
    """One try: a session whose disk is spoiled, looked at as it is left, mended and finished."""
    tally.tries += 1
    with place.start() as process:
        _spoil_after(place, process, captures, spoil)
        tally.told += _is_told(process, tally.messages, place)
    tally.damaged += not _is_sound(place.session)
    before = _held(place.session)
    tally.kept.append(len(before))
    mend()
    _finish(place, tally, before)


def _full_disks(disk: _Disk, places: Iterator[_Place], moments: Sequence[int]) -> Iterator[_Tally]:
    """Sessions on a disk that fills up."""
    for left in LEFT_BYTES:
        tally = _Tally(name=f"disk full, {left / 1e3:g} kB left")
        for captures in moments:
            _spoiled_in_mid_session(
                next(places), tally, captures, partial(disk.leave, left), disk.free
            )
            _clear(disk)
        yield tally


def _quotas(disk: _Disk, places: Iterator[_Place], moments: Sequence[int]) -> Iterator[_Tally]:
    """Sessions whose user has a quota."""
    for left in LEFT_BYTES:
        tally = _Tally(name=f"quota reached, {left / 1e3:g} kB left")
        for captures in moments:
            place = next(places)
            _spoiled_in_mid_session(
                place,
                tally,
                captures,
                partial(_replace_text, place.quota, str(left)),
                place.quota.unlink,
            )
            _clear(disk)
        yield tally


def _read_only(disk: _Disk, places: Iterator[_Place], moments: Sequence[int]) -> Iterator[_Tally]:
    """Sessions whose disk fails, so that the kernel lets nobody write to it any more."""
    tally = _Tally(name="file system read-only after an error")
    for captures in moments:
        _spoiled_in_mid_session(next(places), tally, captures, disk.break_down, disk.mend)
        _clear(disk)
    yield tally


def _refusals(disk: _Disk, places: Iterator[_Place]) -> Iterator[_Tally]:
    """Sessions that are begun on a disk that is full, or read-only."""
    for name, spoil, mend in (
        ("disk full from the start", partial(disk.leave, 0), disk.free),
        ("disk too small for the plan", partial(disk.leave, 60 * 10**6), disk.free),
        ("read-only from the start", disk.mount_read_only, disk.mend),
    ):
        place, tally = next(places), _Tally(name=name, tries=1)
        spoil()
        with place.start() as process:
            tally.told += _is_told(process, tally.messages, place)
        mend()
        tally.kept.append(place.captured())
        _finish(place, tally, {})
        _clear(disk)
        yield tally


def _wrong_clocks(
    disk: _Disk, places: Iterator[_Place], moments: Sequence[int]
) -> Iterator[_Tally]:
    """Sessions during which somebody sets the clock; none may end for that."""
    draw = random.Random(7)
    for name, jumps_s in (
        ("clock set back by 3 days", [-3 * DAY_S]),
        ("clock set forward by 3 days", [3 * DAY_S]),
        (
            "clock set at random after each capture, by up to 30 days",
            [draw.randint(-30, 30) * DAY_S for _ in range(29)],
        ),
    ):
        tally = _Tally(name=name)
        for captures in moments:
            place = next(places)
            tally.tries += 1
            with place.start() as process:
                for number, jump_s in enumerate(jumps_s):
                    _spoil_after(
                        place,
                        process,
                        min(captures + number, CAPTURES - 1),
                        partial(_replace_text, place.clock, str(jump_s)),
                    )
                process.communicate(timeout=LIMIT_S)
            tally.damaged += not _is_sound(place.session)
            before = _held(place.session)
            tally.kept.append(len(before))
            place.clock.unlink()
            _finish(place, tally, before)
            _clear(disk)
        yield tally


def _two_writers(disk: _Disk, places: Iterator[_Place], tries: int) -> Iterator[_Tally]:
    """Two of the same command at the same moment, and other commands that write meanwhile."""
    tally = _Tally(name="two captures begun at the same moment")
    for _ in range(tries):
        place = next(places)
        tally.tries += 1
        with place.start() as one, place.start() as other:
            ends = [_is_told(process, tally.messages, place) for process in (one, other)]
        tally.told += sorted(ends) == [False, True] and {one.returncode, other.returncode} == {0, 1}
        tally.damaged += not _is_sound(place.session)
        before = _held(place.session)
        tally.kept.append(len(before))
        _finish(place, tally, before)
        _clear(disk)
    yield tally
    yield from _second_commands(next(places))
    _clear(disk)


def _second_commands(place: _Place) -> Sequence[_Tally]:
    """Run every other command that writes to a session while one is captured, which waits."""
    tallies = []
    with place.start() as process:
        _spoil_after(place, process, 1, lambda: process.send_signal(signal.SIGSTOP))
        for words in (
            ("session", "note", "late", place.session),
            ("session", "exclude", 0, place.session, "--reason", "late"),
            ("verify", place.session, "--repair"),
        ):
            name = " ".join(str(word) for word in words if word != place.session)
            tally = _Tally(name=f"`{name}` during a capture", tries=1)
            with place.start(*words) as second:
                tally.told += _is_told(second, tally.messages, place)
            tallies.append(tally)
        process.send_signal(signal.SIGCONT)
        process.communicate(timeout=LIMIT_S)
    for tally in tallies:
        tally.damaged += not _is_sound(place.session)
        before = _held(place.session)
        tally.kept.append(len(before))
        _finish(place, tally, before)
    return tallies


def _replace_text(path: Path, text: str) -> None:
    """Replace a file at once: the library reads it all the time."""
    part = path.with_suffix(".part")
    part.write_text(text)
    part.replace(path)


def _clear(disk: _Disk) -> None:
    """Remove the sessions: the next try has an empty disk."""
    _run("find", str(disk.folder), "-mindepth", "1", "-delete")


def _places_on(disk: _Disk, work: Path) -> Iterator[_Place]:
    """A session of its own for each try."""
    number = 0
    while True:
        number += 1
        yield _Place(session=disk.folder / f"session{number}", work=work)


def _section(tallies: Sequence[_Tally]) -> str:
    """The section of the page."""
    told = sorted({message for tally in tallies for message in tally.messages})
    lines = [
        HEADING,
        "",
        "Made by `python -m benchmarks.robustness.disk_faults --page docs/soak.md` (root), on an "
        "ext4 file system of its own; sessions of "
        f"{CAPTURES} captures, spoiled after some of them. **Told**: ended with status 1 and one "
        "printable line (of two writers, the second). **Kept**: captures in the journal then. "
        "**Lost**: those of them that were not there with the same bytes at the end. "
        "**Damaged**: sessions that `verify` did not pass as they were left, on the disk as it "
        "was. **Complete**: sessions that the same command completed on a sound disk, "
        "`verify` passed.",
        "",
        environment_line(environment()) + ".",
        "",
        "| fault | tries | told | kept | lost | damaged | complete |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
        *(tally.row() for tally in tallies),
        "",
        "Quota and wall clock were answered by a preloaded library (`disk_faults.c` beside it). "
        "A wrong clock ends nothing and is told nobody: its time stamps are in the journal as it "
        "showed them, and the order of captures is that of the journal's lines. What was said:",
        "",
        *(f"- `{message}`" for message in told),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one try of each")
    parser.add_argument("--page", type=Path, help="replace the section of this Markdown page")
    given = parser.parse_args()
    moments = [7] if given.quick else [1, 22]
    tallies: list[_Tally] = []
    with _workshop() as (disk, work):
        places = _places_on(disk, work)
        for kind in (
            _full_disks(disk, places, moments),
            _quotas(disk, places, moments),
            _read_only(disk, places, moments),
            _refusals(disk, places),
            _wrong_clocks(disk, places, moments),
            _two_writers(disk, places, len(moments)),
        ):
            for tally in kind:
                tallies.append(tally)
                print(tally.row(), *sorted(tally.messages), sep="\n  ", flush=True)
    if given.page is not None:
        text = given.page.read_text(encoding="utf-8").partition(HEADING)[0].rstrip("\n")
        given.page.write_text(f"{text}\n\n{_section(tallies)}", encoding="utf-8")


if __name__ == "__main__":
    main()
