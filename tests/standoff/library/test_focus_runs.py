"""A step of the light is no focus."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.focus import (
    FocusOptions,
    FocusPoint,
    FocusSweep,
    SweepRequest,
    fit_focus_peak,
    light_fault,
    pooled_errs,
    sweep_bench,
)
from hil_mocks import SimulatedBench
from standoff.console.monitors import field_regions
from standoff.library import devices_of
from standoff.library.bench._devices import OpenBench
from tests.hil_mocks.benches import bench_config


def points_of(levels_dn: list[float]) -> tuple[FocusPoint, ...]:
    return tuple(
        FocusPoint(
            height_mm=100.0 + number, value=1.0, err=0.1, level_dn=level, saturated_fraction=0.0
        )
        for number, level in enumerate(levels_dn)
    )


@given(
    st.floats(-0.1, 0.1),
    st.floats(-0.02, 0.02),
    st.integers(7, 40),
)
def test_light_that_changes_smoothly_with_height_is_no_fault(
    slope: float, bend: float, count: int
) -> None:
    numbers = np.arange(count) - count / 2
    levels = 1000 * np.exp(slope * numbers + bend * numbers**2 / 2)
    assert light_fault(points_of([float(level) for level in levels])) is None


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 3.0])
@pytest.mark.parametrize("at", [2, 5, 9])
def test_a_step_of_the_light_is_named_with_its_heights(factor: float, at: int) -> None:
    levels = [1000.0 * (factor if number >= at else 1.0) for number in range(12)]
    fault = light_fault(points_of(levels))
    assert fault is not None
    assert f"between {99 + at}.00 and {100 + at}.00 mm" in fault
    assert f"{100 * abs(factor - 1):.0f} %" in fault


@pytest.mark.slow
def test_a_sweep_measures_further_regions_and_finds_their_peaks() -> None:
    config = bench_config(simulated__focus_distance_mm=200.0, simulated__f_number=1.0)
    simulated = SimulatedBench(config)
    simulated.place("coins")
    opened = OpenBench(
        camera=simulated.camera,
        stage=simulated.stage,
        clock=lambda: simulated.clock.now_s,
        sleep=simulated.clock.advance,
        simulated=simulated,
    )
    request = SweepRequest(
        heights_mm=(180.0, 220.0),
        steps=11,
        frames=4,
        ends_at_peak=True,
        field=tuple(field_regions((64, 96)).values()),
    )
    found = sweep_bench(devices_of(opened, config), FocusOptions(), request, lambda _: None)
    assert found.peak is not None
    assert simulated.stage.position_mm() == pytest.approx(found.peak.height_mm, abs=0.01)
    assert len(found.field) == 4
    seen = [peak.height_mm for peak in found.field if peak is not None]
    assert seen == pytest.approx([found.peak.height_mm] * len(seen), abs=6)
    assert seen


def found_between(
    low_mm: float,
    high_mm: float,
    *,
    width_mm: float = 20.0,
    noise: float = 3e-4,
    share: float = 0.0,
) -> FocusSweep:
    """A sweep over the values of an edge that is sharp at 300 mm."""
    heights_mm = np.linspace(low_mm, high_mm, 15)
    values = 1 / np.hypot(1, (heights_mm - 300) * (300 / heights_mm) / width_mm)
    points = tuple(
        FocusPoint(height_mm=height, value=value, err=1e-4, level_dn=1000.0, saturated_fraction=0.0)
        for height, value in zip(heights_mm.tolist(), values.tolist(), strict=True)
    )
    values = values + np.random.default_rng(3).normal(0, noise, values.size)
    peak = fit_focus_peak(heights_mm, values, texture_share=share)
    return FocusSweep(points=points, peak=peak, why_not=None)


def test_a_sweep_of_the_flat_top_alone_is_said_to_be_too_narrow() -> None:
    assert found_between(220.0, 380.0).remark is None
    remark = found_between(291.0, 309.0, noise=6e-3).remark
    assert remark is not None
    assert "sweep further on both sides" in remark


def test_a_sweep_says_which_part_of_its_error_is_of_what_it_does_not_know() -> None:
    wide = found_between(240.0, 360.0, width_mm=80.0, noise=1e-3)
    assert wide.remark is not None
    assert "entrance pupil" in wide.remark
    texture = found_between(260.0, 340.0, share=1.0)
    assert texture.remark is not None
    assert "scale" in texture.remark
    # d ln F / d ln distance of 1 shifts the top of a peak of width w at a distance D by w^2 / D.
    assert texture.peak is not None
    assert texture.peak.scale_err_mm == pytest.approx(20**2 / 300, rel=0.5)


@pytest.mark.parametrize("frames", [2, 10])
def test_the_errors_of_heights_from_two_frames_count_little(frames: int) -> None:
    rng = np.random.default_rng(5)
    errs = np.sqrt(rng.chisquare(frames - 1, 200) / (frames - 1))
    pooled = pooled_errs(errs, frames)
    assert np.std(pooled) < 0.35 * np.std(errs)
    assert pooled_errs(np.append(errs, 100.0), 10)[-1] > 30  # where the camera moved
