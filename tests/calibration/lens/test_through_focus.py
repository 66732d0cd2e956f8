"""Focus over the field and depth of focus against closed forms."""

from dataclasses import replace
from math import pi, radians

import numpy as np
import pytest

from benchmarks.truth.focus_scenes import FocusedLens, chart, squares
from calibration.edges import EdgeImage, EdgeMeasurement, EdgeSelection
from calibration.estimate import NORMAL_95
from calibration.lens import StatedContrast, ThroughFocus, through_focus
from calibration.sharpness import MeasuredValue, Picture
from tests.calibration.known import known

STATED = StatedContrast(contrast=0.25, freq_cy_per_px=0.2)
POSITIONS_MM = tuple(np.round(np.linspace(-0.2, 0.28, 9), 3).tolist())
PICTURE = Picture(width_px=420, height_px=320, pixel_pitch_um=6.0)
LENS = FocusedLens(
    width_px=420,
    height_px=320,
    best_mm=0.04,
    sigma_px=0.6,
    blur_px_per_mm=9.0,
    tangential_mm=-0.09,
    sagittal_mm=0.05,
    tilt_x_mm=0.05,
    tilt_y_mm=-0.03,
)
FLAT = replace(LENS, tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0)


def edges_of(lens: FocusedLens, growth_per_mm: float = 0.0) -> list[EdgeMeasurement]:
    """Edges of a chart of six squares at every position, at an SNR of 150."""
    rng, middles = np.random.default_rng(9), squares(lens, 3, 2)
    found: list[EdgeMeasurement] = []
    for position in POSITIONS_MM:
        image = chart(lens, middles, 28.0, 6.0, position, 1 + growth_per_mm * position)
        source = EdgeImage(name=f"{position}", image_dn=image + rng.normal(0, 16.0, image.shape))
        found += EdgeSelection().measured_in(source, "all-angles")
    return found


def measured(edges: list[EdgeMeasurement]) -> ThroughFocus | None:
    return through_focus(edges, {f"{one}": one for one in POSITIONS_MM}, PICTURE, STATED, "focus")


@pytest.fixture(scope="module")
def edges() -> list[EdgeMeasurement]:
    return edges_of(LENS, growth_per_mm=0.1)


@pytest.fixture(scope="module")
def focus(edges: list[EdgeMeasurement]) -> ThroughFocus:
    return known(measured(edges))


def assert_is(value: MeasuredValue, truth: float, depth_mm: float) -> None:
    """Within 2 % of the depth of focus, and within four standard errors."""
    assert value.value == pytest.approx(truth, abs=0.02 * depth_mm)
    assert value.value == pytest.approx(truth, abs=4 * value.err)


def test_tilt_curvature_and_astigmatism_are_those_of_the_lens(focus: ThroughFocus) -> None:
    depth = known(focus.depth_mm).value
    field = known(focus.field)
    assert_is(focus.best_mm, LENS.best_mm, depth)
    assert_is(field.tilt_x_mm, LENS.tilt_x_mm, depth)
    assert_is(field.tilt_y_mm, LENS.tilt_y_mm, depth)
    assert_is(field.tilt_mm, np.hypot(LENS.tilt_x_mm, LENS.tilt_y_mm), depth)
    assert_is(field.tangential_mm, LENS.tangential_mm, depth)
    assert_is(field.sagittal_mm, LENS.sagittal_mm, depth)
    assert_is(field.astigmatism_mm, LENS.tangential_mm - LENS.sagittal_mm, depth)
    assert_is(field.curvature_mm, 0.5 * (LENS.tangential_mm + LENS.sagittal_mm), depth)


def test_the_sensor_is_turned_by_its_tilt_over_its_size(focus: ThroughFocus) -> None:
    by_hand = np.hypot(0.05 / (420 * 0.006), -0.03 / (320 * 0.006))
    turn = known(known(focus.field).tilt_deg)
    assert turn.value == pytest.approx(np.degrees(np.arctan(by_hand)), abs=4 * turn.err)


def test_every_edge_has_its_own_best_focus_and_depth(focus: ThroughFocus) -> None:
    assert len(focus.points) == 24
    inside = []
    for point in focus.points:
        normal = radians(point.angle_deg) + pi / 2
        best, variance = LENS.best_across(point.x_px, point.y_px, normal)
        assert_is(point.best_mm, best, known(point.depth_mm).value)
        inside.append(abs(point.best_mm.value - best) <= NORMAL_95 * point.best_mm.err)
        depth = LENS.depth_mm((point.x_px, point.y_px), normal, 0.25, 0.2)
        assert known(point.depth_mm).value == pytest.approx(depth, rel=0.02)
        contrast = LENS.contrast_across(variance, normal, 0.2)
        assert point.contrast.value == pytest.approx(contrast, rel=0.02)
        assert point.curve(np.array(point.best_mm.value)) == pytest.approx(point.contrast.value)
    assert np.mean(inside) >= 0.8  # 24 of 95 %: 19 or fewer in 1 of 100 cases


def test_the_common_depth_is_where_all_edges_are_sharp(focus: ThroughFocus) -> None:
    ends = []
    for point in focus.points:
        normal = radians(point.angle_deg) + pi / 2
        best, _ = LENS.best_across(point.x_px, point.y_px, normal)
        half = 0.5 * LENS.depth_mm((point.x_px, point.y_px), normal, 0.25, 0.2)
        ends.append((best - half, best + half))
    common = min(far for _, far in ends) - max(near for near, _ in ends)
    assert known(focus.common_depth_mm).value == pytest.approx(common, rel=0.02)


def test_a_picture_that_grows_does_not_bend_the_field() -> None:
    # Edges move to where there is more astigmatism; uncorrected, both are over 0.002 mm off.
    lens = replace(LENS, tangential_mm=0.1, sagittal_mm=-0.1, tilt_x_mm=0.0, tilt_y_mm=0.0)
    field = known(known(measured(edges_of(lens, growth_per_mm=0.3))).field)
    assert field.tangential_mm.value == pytest.approx(0.1, abs=0.0015)
    assert field.sagittal_mm.value == pytest.approx(-0.1, abs=0.0015)
    assert abs(field.curvature_mm.value) <= 4 * field.curvature_mm.err


def test_a_flat_field_has_no_tilt_and_no_curvature() -> None:
    field = known(known(measured(edges_of(FLAT))).field)
    for value in (field.tilt_x_mm, field.tilt_y_mm, field.tangential_mm, field.sagittal_mm):
        assert abs(value.value) <= 4 * value.err


def test_what_does_not_change_with_the_position_has_no_best_focus() -> None:
    lens = replace(FLAT, blur_px_per_mm=0.0)
    assert measured(edges_of(lens)) is None


def test_fewer_than_five_positions_are_no_series(edges: list[EdgeMeasurement]) -> None:
    few = {f"{one}": one for one in POSITIONS_MM[::3]}
    assert through_focus(edges, few, PICTURE, STATED, "focus") is None


def test_positions_beside_the_focus_have_no_best(edges: list[EdgeMeasurement]) -> None:
    # All edges are best above -0.1 mm; what is below falls towards the end.
    one_side = {f"{one}": one for one in POSITIONS_MM}
    far = [edge for edge in edges if one_side[edge.image] >= 0.16]
    assert through_focus(far, one_side, PICTURE, STATED, "focus") is None


def test_a_few_edges_have_a_best_focus_and_no_field(edges: list[EdgeMeasurement]) -> None:
    middle = [edge for edge in edges if 180 < edge.x_px < 240 and edge.y_px < 160]
    found = known(measured(middle))
    assert found.field is None
    assert "7 are needed" in known(found.no_field_because)
    assert found.best_mm.value == pytest.approx(np.median([p.best_mm.value for p in found.points]))


def test_a_contrast_that_is_never_reached_has_no_depth(edges: list[EdgeMeasurement]) -> None:
    never = StatedContrast(contrast=0.98, freq_cy_per_px=0.2)
    positions = {f"{one}": one for one in POSITIONS_MM}
    found = known(through_focus(edges, positions, PICTURE, never, "focus"))
    assert found.depth_mm is None
    assert found.common_depth_mm is None
    assert "focus.min_depth_mm" not in found.limits()


def test_limits_bound_moduli(focus: ThroughFocus) -> None:
    limits = focus.limits()
    field = known(focus.field)
    assert limits["focus.max_curvature_mm"].value == abs(field.curvature_mm.value)
    assert limits["focus.max_astigmatism_mm"].low > 0
    assert limits["focus.min_depth_mm"].value == known(focus.depth_mm).value


@pytest.mark.parametrize(("contrast", "freq"), [(0.0, 0.2), (1.0, 0.2), (0.2, 0.0), (0.2, 1.5)])
def test_a_contrast_that_means_nothing_is_refused(contrast: float, freq: float) -> None:
    with pytest.raises(ValueError, match="must lie between 0 and 1"):
        StatedContrast(contrast=contrast, freq_cy_per_px=freq)
