"""The examples run from start to end, with nothing of ours but ``import standoff``."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
OURS = {"acquisition", "calibration", "simulation", "analysis", "hil_mocks", "tests"}

pytestmark = pytest.mark.slow


def run(name: str, *arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, EXAMPLES / name, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        timeout=1200,
    )
    return done.stdout


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_needs_the_front_door_alone(path: Path) -> None:
    imported = {
        name
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [str(node.module)]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert "standoff" in imported
    assert not {name for name in imported if name.split(".")[0] in OURS}
    assert not {name for name in imported if name.startswith("standoff.")}


def test_the_psf_of_known_edges_is_found(tmp_path: Path) -> None:
    out = run("psf_from_edges.py", "--out", tmp_path)
    assert (tmp_path / "psf.png").read_bytes()[:4] == b"\x89PNG"
    found = [float(text) for text in re.findall(r"sigma_[xy] (\S+) ±", out)]
    assert found == pytest.approx([0.76, 0.67], abs=0.002)  # the edges' own widths


def test_what_distance_costs_is_shown(tmp_path: Path) -> None:
    out = run("how_far_away.py", "--out", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "followups.png",
        "curves.png",
        "limits.png",
    }
    assert "zoom up to" in out


def test_the_one_change_is_found(tmp_path: Path) -> None:
    out = run("what_changed.py", "--out", tmp_path)
    changed = int(re.findall(r"(\d+) of \d+ px beyond", out)[0])
    assert 20 < changed < 300  # a spot of 4 px, seen from 1.4 times further away
    x, y, amplitude = map(float, re.findall(r"at (\S+), (\S+): (\S+) DN", out)[0])
    # 152, 57 of 384 x 303 px, in 274 x 216 px about the same middle.
    assert x == pytest.approx((152 - 191.5) / 1.4 + 136.5, abs=0.5)
    assert y == pytest.approx((57 - 151) / 1.4 + 107.5, abs=0.5)
    assert amplitude == pytest.approx(12.0, abs=2.0)
    assert (tmp_path / "changes.png").is_file()


def test_noise_and_geometry_of_a_bench_are_its_own(tmp_path: Path) -> None:
    out = run("noise_and_geometry.py", "--out", tmp_path)
    for name in ("noise.json", "noise.html", "geometry.json", "geometry.html"):
        assert (tmp_path / name).is_file(), name
    zoom = float(re.findall(r"the scene is (\S+) times smaller", out)[0])
    assert zoom == pytest.approx((300 + 12.5) / (160 + 12.5), rel=1e-3)  # the bench's pupil


def test_models_are_ranked_by_what_was_captured(tmp_path: Path) -> None:
    out = run("how_well_is_it_simulated.py", "--out", tmp_path)
    mse = {
        name: float(value) for name, value in re.findall(r"(\w+): correlation .* MSE (\S+)", out)
    }
    assert set(mse) == {"bicubic", "paper", "matched", "lmmse"}
    assert max(mse["matched"], mse["lmmse"]) < mse["paper"] < mse["bicubic"]
    assert (tmp_path / "validation" / "report.html").is_file()


def test_followups_are_judged_and_the_one_change_appears(tmp_path: Path) -> None:
    out = run("many_followups.py", "--out", tmp_path)
    verdicts = re.findall(r"d' (\S+), accepted: (\w+)", out)
    d_primes = [float(value) for value, _ in verdicts]
    assert d_primes == sorted(d_primes, reverse=True)
    assert [word for _, word in verdicts] == [str(value >= 3) for value in d_primes]
    counts = [int(count) for count in re.findall(r"(\d+) changes", out)]
    assert counts[0] == 0
    assert min(counts[1:]) >= 1
    assert (tmp_path / "changes" / "report.html").is_file()


def test_a_crack_is_lost_when_it_is_thinner_than_a_pixel(tmp_path: Path) -> None:
    out = run("own_detector.py", "--out", tmp_path)
    found = {
        name: [float(auc) for auc in re.findall(r"(\d\.\d+) at zoom", line)]
        for name, line in re.findall(r"(mole|crack): (.*)", out)
    }
    assert found["mole"][0] > 0.95
    assert found["crack"][0] > 0.95
    assert found["crack"][-1] < found["crack"][0] - 0.03
    assert (tmp_path / "crack.html").is_file()
