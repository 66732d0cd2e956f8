"""Things on the plane: closed forms of perspective, and changes between two views of them."""

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from acquisition.bench import load_bench
from analysis.changes import changes_between
from hil_mocks.truth import BenchTruth, CameraPose
from hil_mocks.truth.relief import WALL, Relief, Thing
from hil_mocks.truth.scenes import Edge, Placed, SceneWithRelief, Uniform
from hil_mocks.truth.targets import scene_of

BENCH = Path("configs/simulated.toml")
COIN = Thing(
    outline="coin", x_mm=5.0, y_mm=-3.0, half_x_mm=10.0, half_y_mm=10.0, height_mm=4.0,
    top=Uniform(level=0.5),
)  # fmt: skip


def grid(half_mm: float, step_mm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.meshgrid(*[np.arange(-half_mm, half_mm, step_mm)] * 2)
    return x, y


@settings(max_examples=25)
@given(
    x_mm=st.floats(-60, 60), y_mm=st.floats(-60, 60), distance_mm=st.floats(50, 500),
)  # fmt: skip
def test_a_top_is_seen_larger_and_away_from_the_pupil(
    x_mm: float, y_mm: float, distance_mm: float
) -> None:
    """Of similar triangles: D / (D - h) as large, about the pupil."""
    seen = Relief(ground=Uniform(), things=(COIN,)).seen_from(x_mm, y_mm, distance_mm)
    larger = distance_mm / (distance_mm - COIN.height_mm)
    middle = x_mm + (COIN.x_mm - x_mm) * larger, y_mm + (COIN.y_mm - y_mm) * larger
    step_mm = 0.1
    x, y = (axis + at for axis, at in zip(grid(16.0, step_mm), middle, strict=True))
    top = seen.height_mm(x, y) == COIN.height_mm
    assert np.count_nonzero(top) * step_mm**2 == pytest.approx(
        pi * (COIN.half_x_mm * larger) ** 2, rel=5e-3
    )
    assert x[top].mean() == pytest.approx(middle[0], abs=step_mm)
    assert y[top].mean() == pytest.approx(middle[1], abs=step_mm)
    np.testing.assert_allclose(seen.reflectance(x[top], y[top], 0.0), 0.5)


def test_a_wall_is_seen_from_its_side_alone() -> None:
    seen = Relief(ground=Uniform(), things=(COIN,)).seen_from(200.0, COIN.y_mm, 200.0)
    # The base ends at x = 15; the top's right end is seen at 200 + (15 - 200) 200 / 196 = 11.22.
    row = np.array([11.0, 11.4, 14.8, 15.2])
    level = seen.reflectance(row, np.full(4, COIN.y_mm), 0.0)
    np.testing.assert_allclose(level, [0.5, WALL, WALL, 1.0])
    np.testing.assert_array_equal(
        seen.height_mm(row, np.full(4, COIN.y_mm)), [4.0, np.nan, np.nan, 0.0]
    )


def test_what_is_as_flat_as_paper_is_a_picture_on_it_from_everywhere() -> None:
    x, y = grid(20.0, 0.7)
    flat = Relief(ground=Edge(), things=(replace(COIN, height_mm=1e-9),))
    seen = [
        Placed(scene=flat, angle_deg=30.0).seen_from(*pupil, 150.0).reflectance(x, y, 0.4)
        for pupil in ((0.0, 0.0), (70.0, -20.0))
    ]
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-6)
    ground = Placed(scene=Edge(), angle_deg=30.0)
    far = np.hypot(x, y) > 19
    np.testing.assert_allclose(seen[0][far], ground.reflectance(x, y, 0.4)[far], atol=1e-9)
    assert ground.seen_from(70.0, -20.0, 150.0) == ground


def test_a_pupil_below_a_top_is_refused() -> None:
    with pytest.raises(ValueError, match=r"4 mm above the plane is not above all things"):
        Relief(ground=Uniform(), things=(COIN,)).seen_from(0.0, 0.0, 4.0)
    assert isinstance(scene_of("relief"), SceneWithRelief)


@pytest.mark.slow(minutes=1.5)
def test_between_two_views_of_the_bench_parallax_is_right_and_nothing_has_changed() -> None:
    truth = BenchTruth(load_bench(BENCH))
    poses = [CameraPose(height_mm=200.0, offset_x_mm=x_mm) for x_mm in (-6.0, 6.0)]
    rng = np.random.default_rng(5)
    reference, followup = (
        np.mean(
            [
                truth.sensor.expose(
                    truth.sensor.electrons(truth.irradiance("relief", 0.0, pose), 9000.0),
                    0.0, "Mono12", rng,
                )
                for _ in range(10)
            ],
            axis=0,
        )
        for pose in poses
    )  # fmt: skip
    found = changes_between(reference, followup)
    assert found.parallax is not None
    assert found.summary.changed_px <= 0.03 * found.summary.compared_px
    height_mm = truth.seen_height_mm("relief", 0.0, poses[1])
    rows, cols = np.nonzero(found.valid & np.isfinite(height_mm))
    distance_mm = truth.camera.distance_mm(200.0)
    on_plane = truth.camera.to_plane_mm(cols.astype(float), rows.astype(float), poses[1])
    # The point itself, and where on the plane the reference sees it.
    share = 1 - height_mm[rows, cols] / distance_mm
    x_mm = 6.0 + (on_plane[0] - 6.0) * share
    y_mm = on_plane[1] * share
    seen_mm = -6.0 + (x_mm + 6.0) / share, y_mm / share
    true_x, true_y = truth.camera.to_pixel(*seen_mm, poses[0])
    y, x = found.pose.to_reference_px(rows.astype(float), cols.astype(float))
    off_px = np.hypot(x - true_x, y - true_y)
    assert np.median(off_px) < 0.15
    assert np.quantile(off_px, 0.95) < 0.5
    raised = height_mm[rows, cols] >= 4
    assert np.count_nonzero(raised) > 0.5 * np.count_nonzero(height_mm >= 4)
    assert np.median(off_px[raised]) < 0.15
