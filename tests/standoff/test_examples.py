import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"

pytestmark = pytest.mark.slow


def run(name: str, *arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, EXAMPLES / name, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    return done.stdout


def test_follow_ups_of_all_models_are_written(tmp_path: Path) -> None:
    out = run("simulate_followups.py", "--out", tmp_path)
    assert len(list(tmp_path.glob("*.tif"))) == 12
    assert re.search(r"2\.0  lmmse +0\.000", out)


def test_the_width_of_the_simulated_lens_is_within_its_interval_of_the_truth(
    tmp_path: Path,
) -> None:
    out = run("psf_and_mtf.py", "--out", tmp_path / "mtf.png")
    assert (tmp_path / "mtf.png").read_bytes()[:4] == b"\x89PNG"
    found = [float(text) for text in re.findall(r"sigma_. (\S+) px", out)]
    true = [float(text) for text in re.findall(r"true (\S+) and (\S+) px", out)[0]]
    assert found == pytest.approx(true, rel=0.03)  # noise of six single frames
