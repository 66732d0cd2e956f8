import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from analysis.reports import _page as page
from scripts.example_files import make_example_files
from standoff.cli import run
from tests.calibration.closed_form import edge_image


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command left behind: exit status and both streams."""

    status: int
    out: str
    err: str


@dataclass(frozen=True)
class Command:
    """Runs command lines, in this process or in one of its own."""

    run: Callable[[list[str]], Outcome]

    def __call__(self, *arguments: object) -> Outcome:
        """Run a command line: as it is typed, with any number of single words after that."""
        line, words = arguments[:1], arguments[1:]
        return self.run([*shlex.split(" ".join(map(str, line))), *map(str, words)])

    def done(self, *arguments: object) -> Outcome:
        """Run one that does what it is asked for."""
        outcome = self(*arguments)
        assert outcome.status == 0, outcome.err
        return outcome

    def document(self, *arguments: object) -> Any:
        """Run one that does so, and return what it prints with --json."""
        return json.loads(self.done(*arguments, "--json").out)

    def refused(self, status: int, *arguments: object) -> str:
        """Run one that ends with a status, and return what it says on stderr."""
        outcome = self(*arguments)
        assert outcome.status == status, outcome.err
        return outcome.err

    def captured(self, folder: Path, bench: str, plan: str) -> Path:
        """Take a whole session in a folder on a simulated bench, and return where it is."""
        (folder / "b.toml").write_text(bench)
        (folder / "p.toml").write_text(plan)
        words = ("--bench", folder / "b.toml", "--plan", folder / "p.toml", "--yes", "--out")
        self.done("capture", *words, folder / "s")
        return folder / "s"


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs a command line in this process."""

    def run_here(arguments: list[str]) -> Outcome:
        status = run(arguments)
        captured = capsys.readouterr()
        return Outcome(status=status, out=captured.out, err=captured.err)

    return Command(run_here)


@pytest.fixture(scope="module", autouse=True)
def coarse_figures() -> Iterator[None]:
    """Draw figures with few pixels and not laid out: tests of this folder look at none."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(page, "_PNG_DPI", 40)
        patched.setattr(page, "_lay_out", lambda figure: figure.set_layout_engine(None))
        yield


@pytest.fixture
def process() -> Command:
    """Runs a command line in a process of its own, as on a machine without settings."""

    def run_process(arguments: list[str]) -> Outcome:
        environment = {
            name: value for name, value in os.environ.items() if not name.endswith("NUM_THREADS")
        }
        done = subprocess.run(
            [sys.executable, "-m", "standoff", *arguments],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )
        return Outcome(status=done.returncode, out=done.stdout, err=done.stderr)

    return Command(run_process)


@pytest.fixture
def edge_file(tmp_path: Path) -> Path:
    """A 16-bit TIFF of one vertical edge of total sigma 0.8 px, 5 degrees off."""
    path = tmp_path / "edge.tif"
    tifffile.imwrite(path, np.rint(edge_image(0.8, 5.0)).astype(np.uint16))
    return path


TEXTURE = np.random.default_rng(6).integers(0, 4000, (60, 91)).astype(np.uint16)


@pytest.fixture
def image_file(tmp_path: Path) -> Path:
    """A 16-bit TIFF of ``TEXTURE``."""
    path = tmp_path / "texture.tif"
    tifffile.imwrite(path, TEXTURE)
    return path


@pytest.fixture
def psf_file(tmp_path: Path) -> Path:
    """A psf.json of total values alone."""
    path = tmp_path / "psf.json"
    path.write_text(
        json.dumps({"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.8, "rho": 0.1})
    )
    return path


FLAT_DN = 1000.0
FLAT_VARIANCE_DN2 = FLAT_DN / 4.0 + (8.0 / 4.0) ** 2
"""Of one frame of a flat, with the noise of ``noise_file``."""


@pytest.fixture
def noise_file(tmp_path: Path) -> Path:
    """A noise.json of 4 e-/DN and 8 e- of read noise, without black level."""
    path = tmp_path / "noise.json"
    path.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 4.0, "read_noise_e": 8.0,'
        ' "black_level_dn": 0.0, "saturation_dn": 4095.0, "frames_averaged": 1}'
    )
    return path


SMALL_BENCH = """
[camera]
driver = "simulated"
pixel_format = "Mono12"
exposure_us = 12000.0
gain_db = 0.0
frame_rate_hz = 60.0

[stage]
driver = "simulated"
limits_mm = [120.0, 620.0]

[optics]
focal_length_mm = 8.0
pixel_pitch_um = 8.3

[simulated]
width_px = 160
height_px = 128
optical_sigma_x_px = 0.7
optical_sigma_y_px = 0.6
"""

SMALL_PLAN = """
schema = "standoff.plan/1"
name = "small"
heights_mm = [180.0, 300.0]
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0]
"""


@pytest.fixture
def bench_file(tmp_path: Path) -> Path:
    path = tmp_path / "bench.toml"
    path.write_text(SMALL_BENCH)
    return path


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(SMALL_PLAN)
    return path


@pytest.fixture
def capture_line(bench_file: Path, plan_file: Path, tmp_path: Path) -> str:
    """A command that captures the small plan into ``tmp_path / "s"``, but for who places."""
    return f"capture --bench {bench_file} --plan {plan_file} --out {tmp_path / 's'}"


@pytest.fixture(scope="session")
def captured_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete session of six edge captures, taken once; nobody changes it."""
    quiet = Command(lambda words: Outcome(status=run(words), out="", err=""))
    return quiet.captured(tmp_path_factory.mktemp("captured"), SMALL_BENCH, SMALL_PLAN)


@pytest.fixture(scope="session")
def example_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the examples of the reference read, made once; nobody changes them."""
    folder = tmp_path_factory.mktemp("examples") / "files"
    make_example_files(folder)
    return folder


@pytest.fixture(scope="module")
def files(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the files that the examples of the reference read, to work in."""
    return Path(shutil.copytree(example_files, tmp_path_factory.mktemp("files") / "files"))


@pytest.fixture
def session_dir(captured_session: Path, tmp_path: Path) -> Path:
    """A copy of the session, to work in."""
    return Path(shutil.copytree(captured_session, tmp_path / "session"))
