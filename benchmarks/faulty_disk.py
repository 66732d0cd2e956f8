"""An ext4 file system that can be spoiled, and the commands that are run on it."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

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
class Place:
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


class Disk:
    """An ext4 file system in a file."""

    def __init__(self, work: Path) -> None:
        self._image = work / "disk.img"
        self.folder = work / "disk"
        self.folder.mkdir()
        with self._image.open("wb") as file:
            file.truncate(DISK_BYTES)
        run("mkfs.ext4", "-q", "-m", "0", str(self._image))
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
        run("umount", str(self.folder))
        subprocess.run(["e2fsck", "-fy", str(self._image)], capture_output=True, check=False)
        self._mount()

    def mount_read_only(self) -> None:
        """Refuse writes from now on."""
        run("mount", "-o", "remount,ro", str(self.folder))

    def close(self) -> None:
        """Unmount it."""
        run("umount", str(self.folder))

    def _mount(self) -> None:
        run("mount", "-o", "loop,errors=remount-ro", str(self._image), str(self.folder))


def run(*words: str) -> None:
    """Run a system's command."""
    subprocess.run(words, check=True, capture_output=True)
