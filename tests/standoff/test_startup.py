"""What a command line imports: nothing that computes, until a command runs."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from standoff.terminal._app import COMMANDS

COMPUTING = {
    *("PIL", "cv2", "gi", "jinja2", "joblib", "matplotlib", "numba", "numpy", "scipy", "serial"),
    *("skimage", "starlette", "tifffile", "torch", "uvicorn", "weasyprint"),
}
"""Pydantic is not among them: typer itself needs it for the help of a command."""

ALL_HELP = """
import json, sys
from standoff.cli import run
found = {}
for name in json.loads(sys.argv[1]):
    run([name, "--help"])
    found[name] = sorted(sys.modules)
json.dump(found, sys.stderr)
"""


@pytest.mark.slow
def test_the_help_of_no_command_imports_what_computes() -> None:
    words = [sys.executable, "-c", ALL_HELP, json.dumps(list(COMMANDS))]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    imported = json.loads(done.stderr)
    assert {name: COMPUTING & set(modules) for name, modules in imported.items()} == {
        name: set() for name in COMMANDS
    }


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["simulate", "--help"]])
def test_a_process_that_computes_nothing_imports_nothing_for_it(arguments: list[str]) -> None:
    words = [sys.executable, "-X", "importtime", "-m", "standoff", *arguments]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "standoff.cli" in imported
    assert COMPUTING & imported == set()


@pytest.mark.slow
def test_a_psf_of_a_few_edges_imports_no_optimiser_and_no_splines_of_scipy(tmp_path: Path) -> None:
    image = np.full((80, 80), 3000, np.uint16)
    image[21:59, 23:61] = 800
    cv2.imwrite(str(tmp_path / "square.tif"), cv2.GaussianBlur(image, (0, 0), 0.9))
    words = [sys.executable, "-X", "importtime", "-m", "standoff", "calibrate", "square.tif"]
    done = subprocess.run(
        [*words, "--out", "psf.json"], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "calibration.psf._transfer_2d" in imported
    slow = {"matplotlib", "scipy.interpolate", "scipy.optimize", "scipy.spatial", "scipy.stats"}
    assert slow & imported == set()
