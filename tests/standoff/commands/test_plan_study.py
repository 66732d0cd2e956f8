"""``standoff plan-study``: what it prints, what it takes for granted, and what it refuses."""

import json
from pathlib import Path
from typing import Any

import pytest

import standoff
from tests.standoff.conftest import SMALL_BENCH, Command
from tests.standoff.library.test_one_document_study import PLAN

BOARDS = """
[[targets]]
kind = "board"
target = "board"
heights_mm = [340.0, 380.0, 420.0]
"""
REAL = """
[camera]
driver = "aravis"
address = "192.168.10.46"
pixel_format = "Mono12"
exposure_us = 10000.0
gain_db = 0.0
frame_rate_hz = 60.0

[stage]
driver = "manual"
limits_mm = [100.0, 700.0]
tolerance_mm = 0.5

[optics]
focal_length_mm = 8.0
pixel_pitch_um = 8.3
"""


@pytest.fixture
def files(tmp_path: Path, psf_file: Path) -> tuple[object, ...]:
    """Words that name a bench, a plan and a PSF."""
    (tmp_path / "b.toml").write_text(SMALL_BENCH)
    (tmp_path / "p.toml").write_text(PLAN)
    return "--bench", tmp_path / "b.toml", "--plan", tmp_path / "p.toml", "--psf", psf_file


def predicted(document: dict[str, Any], quantity: str) -> dict[str, Any]:
    (found,) = [one for one in document["predicted"] if one["quantity"] == quantity]
    return dict(found)


@pytest.mark.slow
def test_a_table_ends_with_what_to_do_next(command: Command, files: tuple[object, ...]) -> None:
    done = command.done("plan-study", *files, "--want", "sigma=0.001%")
    assert "sigma along x / px" in done.out
    assert done.out.splitlines()[-1].startswith("next: ")
    assert "the focus is taken as the same in every capture" in done.err


@pytest.mark.slow
def test_more_noise_and_shorter_edges_leave_more(
    command: Command, files: tuple[object, ...]
) -> None:
    words = ("plan-study", *files, "--json", "--edge-length")
    long, short = (json.loads(command(*words, length).out) for length in (160, 40))
    errs = [predicted(one, "sigma_x_px")["err"] for one in (long, short)]
    assert errs[1] == pytest.approx(2 * errs[0])
    budget = predicted(long, "sigma_x_px")["budget"]
    assert sum(part["share"] for part in budget) == pytest.approx(1)


@pytest.mark.slow
def test_boards_at_several_heights_tell_the_pupil(
    command: Command, files: tuple[object, ...], tmp_path: Path
) -> None:
    (tmp_path / "p.toml").write_text(PLAN + BOARDS)
    sizes = ("--set", "simulated.width_px=240", "--set", "simulated.height_px=180")
    found = predicted(
        command.document("plan-study", *files, *sizes, "--height-scatter", 0.05), "pupil_offset_mm"
    )
    assert found["err"] > 0.05
    # Three heights leave one degree of freedom: Student's 12.7.
    assert found["half_width_95"] == pytest.approx(12.706 * found["err"], rel=1e-3)
    assert found["budget"][0]["source"] == "heights read back"


@pytest.mark.slow
def test_a_real_bench_without_noise_json_goes_by_the_edges(
    command: Command, files: tuple[object, ...], tmp_path: Path
) -> None:
    (tmp_path / "b.toml").write_text(REAL)
    document = command.document("plan-study", *files)
    assert any("the contrast-to-noise ratio is 100" in text for text in document["assumptions"])
    tilt = predicted(document, "tilt_limit_deg")
    assert tilt["err"] is None
    assert "region_px" in tilt["undetermined"]


@pytest.mark.slow
def test_a_plan_without_edges_says_so(
    command: Command, files: tuple[object, ...], tmp_path: Path
) -> None:
    (tmp_path / "p.toml").write_text(PLAN.replace('"edge"', '"flat"'))
    document = command.document("plan-study", *files, "--want", "sigma=1%")
    assert predicted(document, "sigma_x_px")["undetermined"].startswith("the plan has no capture")
    assert not document["wants"][0]["reached"]


@pytest.mark.slow
def test_the_scatter_of_the_focus_is_taken_from_a_calibration_that_has_it(
    files: tuple[object, ...],
) -> None:
    bench, plan, psf = (Path(str(one)) for one in files[1::2])
    calibration = standoff.read_psf(psf)

    class Focus:
        scatter_px2 = 0.02

    stated = standoff.plan_study(plan, bench, psf, focus_scatter_px2=0.02)
    object.__setattr__(calibration, "focus", Focus())
    known = standoff.plan_study(plan, bench, calibration)
    assert known.of("sigma_x_px").err == pytest.approx(stated.of("sigma_x_px").err)


def test_a_result_that_is_there_is_kept(
    command: Command, files: tuple[object, ...], tmp_path: Path
) -> None:
    out = tmp_path / "study.json"
    out.write_text("kept")
    command.refused(1, "plan-study", *files, "--out", out)
    assert out.read_text() == "kept"


def test_a_file_that_is_missing_is_a_data_error(
    command: Command, files: tuple[object, ...], tmp_path: Path
) -> None:
    err = command.refused(1, "plan-study", *files[:4], "--psf", tmp_path / "none.json")
    assert "none.json" in err
