"""Offline work needs no part of Python that only Unix has."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

UNIX_ALONE = ("fcntl", "termios", "tty", "pty", "pwd", "grp", "resource", "syslog", "gi")
WITHOUT_THEM = f"""
import serial  # has a driver of its own on Windows
import sys
for name in {UNIX_ALONE!r}:
    sys.modules[name] = None  # importing it fails
from standoff.cli import run
sys.exit(run(sys.argv[1:]))
"""


@pytest.mark.slow
def test_a_photograph_is_simulated_without_the_modules_of_unix(tmp_path: Path) -> None:
    photograph, out = tmp_path / "p.tif", tmp_path / "f.tif"
    image = np.random.default_rng(1).integers(0, 4000, (40, 60)).astype(np.uint16)
    tifffile.imwrite(photograph, image)
    words = ["simulate", photograph, "--zoom", "2", "--model", "bicubic", "--out", out]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_THEM, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert tifffile.imread(out).shape == (20, 30)
