"""Bracketed captures in the analyses: they take them as they take any other."""

from pathlib import Path

import pytest

from acquisition.plan import load_plan
from acquisition.session._reader import Session
from standoff.shipped_configs import shipped_config
from tests.standoff.conftest import SMALL_BENCH, Command

PLAN = """
schema = "standoff.plan/1"
name = "bracketed"
heights_mm = [200.0]
frames_per_capture = 4
"""
TARGET = """
[[targets]]
kind = "{kind}"
target = "{target}"
{keys}
bracket = {{ exposures = {exposures}, ratio = {ratio} }}
"""


def captured(command: Command, folder: Path, targets: str, *, top: str = "", seed: int = 1) -> Path:
    path = command.captured(folder, f"{SMALL_BENCH}seed = {seed}\n", PLAN + top + targets)
    command.done("verify", path)
    return path


def test_the_shipped_plan_brackets_a_scene_of_ten_thousand_to_one() -> None:
    (target,) = load_plan(shipped_config("bracket_plan.toml")).targets
    assert target.bracket is not None
    # What the shortest exposure shows at 70 % of 12 bits is at SNR 10 in the longest at 1e-4.
    assert target.bracket.ratios()[-1] >= 100


@pytest.mark.slow
def test_the_psf_of_bracketed_edges_is_the_benchs(command: Command, tmp_path: Path) -> None:
    keys = "orientations_deg = [5.0, 50.0, 95.0]"
    targets = TARGET.format(kind="edge", target="edge", keys=keys, exposures=3, ratio=4.0)
    session = captured(command, tmp_path, targets)
    psf = command.document("calibrate", "--session", session, "--out", tmp_path / "psf.json")
    for axis, true_px in (("x", 0.7), ("y", 0.6)):
        found, error = (psf[f"optical_sigma_{axis}{end}_px"] for end in ("", "_err"))
        assert abs(found - true_px) < 4 * error
        assert error < 0.01


def test_noise_takes_each_exposure_of_bracketed_flats_and_darks(
    command: Command, tmp_path: Path
) -> None:
    targets = TARGET.format(
        kind="flat", target="flat", keys="exposure_us = 800.0", exposures=4, ratio=2.0
    )
    targets += TARGET.format(
        kind="dark", target="dark", keys="exposure_us = 800.0", exposures=2, ratio=8.0
    )
    session = captured(command, tmp_path, targets)
    noise = command.document("noise", "--session", session, "--out", tmp_path / "noise.json")
    # The bench has 5 e-/DN and 12 e-; the file states the standard errors.
    assert abs(noise["gain_e_per_dn"] - 5.0) < 4 * noise["gain_e_per_dn_err"]
    assert abs(noise["read_noise_e"] - 12.0) < 4 * noise["read_noise_e_err"]
    assert noise["gain_e_per_dn_err"] < 0.1


@pytest.mark.slow
def test_changes_between_two_bracketed_captures_of_one_scene_are_none(
    command: Command, tmp_path: Path
) -> None:
    # The shortest exposure saturates the brightest parts of the print, which are left out.
    targets = TARGET.format(
        kind="texture", target="coins", keys="exposure_us = 20000.0", exposures=2, ratio=4.0
    )
    session = captured(command, tmp_path, targets, top="repeats = 2\n", seed=2)
    first, second = Session(session).records
    assert first.saturated_pixels > 20
    out = tmp_path / "changes"
    found = command.document("changes", session / first.file, session / second.file, "--out", out)
    # By chance one pair of twenty has one.
    assert found["changes"] == []
    # The noise of bright pixels, in one exposure, is five times that of dark ones, in both.
    assert found["is_noise_known"]
    assert found["noise_factor"] == pytest.approx(1.0, abs=0.2)
    assert found["saturated_px"] >= first.saturated_pixels
