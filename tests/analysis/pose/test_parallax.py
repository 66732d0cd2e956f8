"""What parallax costs a pose, and which would show less: worked out by moving the camera."""

import numpy as np
import pytest

from analysis.changes import ParallaxMap, SceneParallax
from analysis.pose import ParallaxCost, PoseParallax, parallax_cost, pose_quality
from analysis.pose._quality import quality_with_depth
from analysis.reports import plot_pose, stored_pose_section
from calibration.registration import DistortedPose, PixelParallax
from simulation import SamplingGrid
from simulation.arrays import BoolArray, Float32Array, FloatArray
from tests.analysis.detectability.test_curves import curve
from tests.calibration.parallax.test_viewpoint import ASIDE, CAMERA, FARTHER, SHAPE, Setup

ROWS, COLS = SHAPE


def towards_epipole(setup: Setup, heights: FloatArray) -> Float32Array:
    """Parallax of a whole frame in closed form: h / (1 - h) over depth and distance ratio."""
    y, x = np.indices(SHAPE).astype(np.float64)
    rays = CAMERA.rays(x, y)
    facing = np.tensordot(setup.normal, rays, 1)
    ratio = 1 - setup.normal @ setup.centre
    seen = CAMERA.matrix @ setup.centre
    share = -heights / (1 - heights) * facing / ratio
    sign = 1.0 if seen[2] >= 0 else -1.0
    reach = sign * np.hypot(seen[0] - seen[2] * x, seen[1] - seen[2] * y)
    return np.asarray(share * reach / (1 + share * seen[2]), dtype=np.float32)


def cost_of(setup: Setup, heights: FloatArray, hidden: BoolArray | None = None) -> ParallaxCost:
    is_hidden = np.zeros(SHAPE, dtype=np.bool_) if hidden is None else hidden
    parallax = np.where(is_hidden, np.float32(np.nan), towards_epipole(setup, heights))
    depth = PixelParallax(
        displaced_px=np.zeros((2, *SHAPE), dtype=np.float32),
        restored_px=np.zeros((2, *SHAPE), dtype=np.float32),
        is_seen=~is_hidden,
        is_seen_back=~is_hidden,
        error_px=np.full(SHAPE, 0.25, dtype=np.float32),
        photograph="followup",
    )
    x, y, w = setup.epipole.tolist()
    found = SceneParallax(
        low_px=0.0, median_px=0.0, high_px=0.0, err_px=0.1, epipole=(x, y, w), features=100,
        agreeing=90, hidden_px=0, held_out_gain=0.5, larger_is="nearer",
    )  # fmt: skip
    pose = DistortedPose(
        matrix=setup.matrix, k1=0.0, reference_shape=SHAPE, followup_shape=SHAPE, parallax=depth
    )
    seen = ParallaxMap(parallax_px=parallax, error_px=0 * parallax, is_hidden=is_hidden)
    return parallax_cost(pose, seen, found)


def slope() -> FloatArray:
    """Heights over a frame, from none to a tenth of the distance."""
    return np.asarray(0.1 * np.indices(SHAPE)[1] / (COLS - 1), dtype=np.float64)


@pytest.mark.parametrize("centre", [ASIDE, FARTHER])
def test_the_direction_is_that_to_the_line_on_which_the_reference_was_taken(
    centre: tuple[float, float, float],
) -> None:
    found = cost_of(Setup.of(centre), slope()).figures
    aside = np.array(centre[:2]) / np.hypot(*centre[:2])
    assert found.move is not None
    np.testing.assert_allclose(found.move, aside, atol=0.03)


def test_in_line_there_is_left_what_a_camera_sees_there() -> None:
    # With the reference straight ahead a point is displaced to or from the middle of the frame, by
    # its distance from there and the baseline along the axis.
    setup, heights = Setup.of(FARTHER), slope()
    found = cost_of(setup, heights).figures
    y, x = np.indices(SHAPE).astype(np.float64)
    depth = (1 - heights) / np.tensordot(setup.normal, CAMERA.rays(x, y), 1)
    share = heights / depth / (1 - setup.normal @ setup.centre) * FARTHER[2]
    left = share / (1 - share) * np.hypot(x - 199.5, y - 149.5)
    expected = np.ptp(np.percentile(left, [2.5, 97.5]))
    assert found.in_line_range_px == pytest.approx(expected, rel=1e-4)
    assert found.in_line_range_px < 0.5 * found.range_px
    low, high = np.percentile(towards_epipole(setup, heights), [2.5, 97.5])
    assert (found.low_px, found.high_px) == pytest.approx((low, high), rel=1e-4)
    assert found.range_px == pytest.approx(high - low, rel=1e-4)


def test_hidden_pixels_are_counted_and_errors_are_in_reference_pixels() -> None:
    hidden = np.zeros(SHAPE, dtype=np.bool_)
    hidden[:, : COLS // 4] = True
    cost = cost_of(Setup.of(FARTHER), slope(), hidden)
    assert cost.figures.hidden == 0.25
    assert cost.is_hidden is hidden
    zoom = DistortedPose(
        matrix=Setup.of(FARTHER).matrix, k1=0.0, reference_shape=SHAPE, followup_shape=SHAPE
    ).zoom
    assert cost.figures.place_err_px == pytest.approx(0.25 * zoom)


def figures(**values: object) -> PoseParallax:
    about = {"low_px": -2.0, "high_px": 8.0, "range_px": 10.0, "in_line_range_px": 1.5}
    return PoseParallax.model_validate({**about, "hidden": 0.06, "place_err_px": 0.1, **values})


@pytest.mark.parametrize(
    ("move", "said"),
    [
        ((1.0, 0.1), "moved to the right,"),
        ((-0.7, 0.7), "moved to the bottom left,"),
        ((0.1, -1.0), "moved to the top,"),
        (None, "moved sideways,"),
    ],
)
def test_the_sentence_names_the_direction_as_the_picture_has_it(
    move: tuple[float, float] | None, said: str
) -> None:
    sentence = figures(move=move).sentence
    assert said in sentence
    assert "over 10.0 px" in sentence
    assert "6 % of the overlap" in sentence
    assert "1.5 px would be left" in sentence


def test_where_a_move_would_not_help_none_is_named() -> None:
    sentence = figures(in_line_range_px=9.0, move=(1.0, 0.0)).sentence
    assert "moving sideways would not reduce it much" in sentence
    assert "right" not in sentence


def hiding(is_hidden: BoolArray) -> ParallaxCost:
    return ParallaxCost(figures=figures(), is_hidden=is_hidden)


def test_what_is_hidden_is_not_judged() -> None:
    # Tilted about the vertical axis: the further a column, the coarser it is sampled.
    matrix = np.array([[1.3, 0.0, 0.0], [0.0, 1.3, 0.0], [-4e-4, 0.0, 1.0]])
    size = (COLS, ROWS)
    whole = pose_quality(matrix, size, (900, 700), curve(), 2.0)
    is_hidden = np.zeros(SHAPE, dtype=np.bool_)
    is_hidden[:, COLS // 2 :] = True
    half = quality_with_depth(whole, whole.curve, hiding(is_hidden))
    columns = np.linspace(0, COLS - 1, whole.d_prime.shape[1])
    is_left = np.rint(columns) < COLS // 2
    np.testing.assert_array_equal(np.isnan(half.d_prime), np.tile(~is_left, (76, 1)))
    assert half.decisive_d_prime == whole.d_prime[:, is_left].min() > whole.decisive_d_prime
    assert half.sampling.overlap == whole.sampling.overlap


@pytest.mark.parametrize("is_hidden", [False, True])
def test_where_nothing_or_all_is_hidden_the_verdict_is_as_it_was(*, is_hidden: bool) -> None:
    size = (COLS, ROWS)
    whole = pose_quality(SamplingGrid.centred(SHAPE, 1.2).matrix, size, size, curve(), 2.0)
    again = quality_with_depth(whole, whole.curve, hiding(np.full(SHAPE, is_hidden)))
    assert again.summary == whole.summary
    np.testing.assert_array_equal(again.d_prime, whole.d_prime)


def test_the_picture_says_what_the_parallax_costs() -> None:
    size = (COLS, ROWS)
    judged = pose_quality(SamplingGrid.centred(SHAPE, 1.2).matrix, size, size, curve(), 2.0)
    plain = plot_pose(None, judged).axes[0].get_title()
    said = plot_pose(None, judged, said=figures().short_sentence).axes[0].get_title()
    assert said == f"{plain}\nparallax of 95 %: 10.0 px; hidden or unknown: 6 % of the overlap"


def test_a_report_tells_of_the_parallax_of_a_stored_verdict() -> None:
    size = (COLS, ROWS)
    judged = pose_quality(SamplingGrid.centred(SHAPE, 1.2).matrix, size, size, curve(), 2.0)
    flat, deep = (
        repr(stored_pose_section("p", judged.summary.model_copy(update={"parallax": parallax})))
        for parallax in (None, figures())
    )
    assert "parallax of 95 % of the pixels" not in flat
    assert "('parallax of 95 % of the pixels', '10.0 px')" in deep
    assert "The scene has depth" in deep
