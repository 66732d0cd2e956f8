"""Pixels at an end of the scale, and two photographs of one view; the noise is drawn here."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.ndimage import gaussian_filter

from analysis.changes import ChangeOptions, changes_between
from analysis.changes._ends import clipped_at_white, unusable
from analysis.changes._photograph_pair import nearest_shift, one_view
from analysis.errors import OverlapError
from calibration.registration import DistortedPose, RegistrationHints
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import at_rest
from tests.shipped import shipped

SHAPE = (120, 160)


def light(seed: int = 0, noise_dn: float = 1.2) -> FloatArray:
    """A ramp from 20 to 235 with noise."""
    rng = np.random.default_rng(seed)
    ramp = np.broadcast_to(np.linspace(20, 235, SHAPE[1]), SHAPE)
    return np.asarray(ramp + noise_dn * rng.standard_normal(SHAPE))


def with_gloss(levels: FloatArray) -> FloatArray:
    bright = levels.copy()
    bright[40:60, 30:50] += 400.0
    return bright


@pytest.mark.parametrize(
    ("white", "scale", "step"),
    [(255.0, 1.0, 1.0), (4095.0, 16.0, 1.0), (65520.0, 256.0, 16.0), (65535.0, 257.0, 1.0)],
    ids=["8 bits", "12 bits", "12 bits in 16", "16 bits"],
)
@pytest.mark.parametrize("is_told", [True, False])
def test_what_is_clipped_is_marked_and_nothing_else(
    white: float, scale: float, step: float, is_told: bool
) -> None:
    stored = np.clip(np.rint(with_gloss(light()) * scale / step) * step, 0, white)
    marked = unusable(stored, white if is_told else None)
    assert np.array_equal(marked, stored == white)
    assert marked[40:60, 30:50].all()


def test_a_plateau_below_white_and_of_floats_is_found() -> None:
    levels = np.minimum(with_gloss(light()), 250.25)
    assert np.array_equal(unusable(levels, 255.0), levels == 250.25)


def test_levels_that_thin_out_are_no_plateau() -> None:
    for step in (1.0, 0.25):
        assert not unusable(np.rint(light() / step) * step, 255.0).any()
    bars = np.rint(
        np.where(np.arange(SHAPE[1]) // 20 % 2, 60.0, 180.0) + 0.4 * (light() - light(1))
    )
    assert not unusable(bars, 255.0).any()


def test_single_pixels_at_white_are_left_to_the_noise() -> None:
    levels = np.rint(light())
    levels[7, 9] = 255.0
    assert not unusable(levels, 255.0).any()


@pytest.mark.parametrize("white", [1.0, 255.0, 4095.0])
def test_a_few_pixels_at_an_end_of_the_file_count_where_they_lie_together(white: float) -> None:
    # Two of 19,200 pixels are no plateau; a blob of four is clipped light all the same.
    levels = np.rint(light(noise_dn=0.4))
    levels[60:62, 70:72], levels[30, 20:22] = 255.0, 255.0
    levels[90:92, 70:72], levels[15, 120] = 0.0, 0.0
    marked = unusable(levels * (white / 255.0), None)
    expected = np.zeros_like(marked)
    expected[60:62, 70:72] = expected[90:92, 70:72] = True
    assert np.array_equal(marked, expected)
    within = np.clip(levels, 1.0, 254.0) * (white / 255.0)  # ends that no file has
    assert not unusable(within, None).any()


def test_black_counts_where_it_is_the_rule() -> None:
    levels = np.clip(np.rint(light() - 60.0), 0, None)
    marked = unusable(levels, None)
    assert marked[:, :20].all()  # light of -40 to -13
    assert not marked[:, 40:].any()
    assert not clipped_at_white(levels, None).any()
    grains = np.rint(light()) + 0.0
    grains[::6, ::6] = 0.0
    assert not unusable(grains, None).any()


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    levels=st.integers(1, 300),
    white=st.none() | st.floats(-10, 300),
)
@settings(max_examples=60, deadline=None)
def test_any_photograph_has_a_mask_that_turns_with_it(
    seed: int, shape: tuple[int, int], levels: int, white: float | None
) -> None:
    image = np.random.default_rng(seed).integers(0, levels, shape).astype(np.float64)
    marked = unusable(image, white)
    assert marked.shape == shape
    assert np.array_equal(unusable(image[::-1].T, white), marked[::-1].T)


def chart(seed: int = 3) -> FloatArray:
    """A drawing of two levels, no line of which any code of ours drew: scikit-image's horse."""
    return np.where(shipped("horse")[:320, :390] > 0, 255.0, 0.0)


@pytest.mark.slow
def test_a_word_that_is_gone_from_clipped_paper_is_found() -> None:
    page = shipped("page")
    page = np.minimum(page * 1.35, 255.0)
    assert np.mean(page == 255) > 0.1
    erased = page.copy()
    erased[95:106, 180:204] = 255.0
    result = changes_between(page, erased, options=ChangeOptions(white_level_dn=(255.0, 255.0)))
    assert len(result.summary.changes) == 1
    (word,) = result.summary.changes
    assert (word.what, abs(word.x_px - 191.5) < 5, abs(word.y_px - 100) < 5) == ("gone", True, True)


@pytest.mark.slow
def test_two_levels_are_compared_with_each_other() -> None:
    before, after = chart(), chart()
    # A spot of either kind, amid the other level.
    after[40:48, 40:48] = 255.0 - before[44, 44]
    after[160:168, 200:208] = 255.0 - before[164, 204]
    found = changes_between(before, after).summary
    places = sorted((round(one.x_px), round(one.y_px)) for one in found.changes)
    assert [(abs(x - 43.5) < 2, abs(y - 43.5) < 2) for x, y in places[:1]] == [(True, True)]
    assert len(places) == 2
    assert changes_between(before, before).summary.changes == ()


@pytest.mark.slow
def test_where_both_are_at_one_end_nothing_is_compared() -> None:
    rng = np.random.default_rng(1)
    scene = shipped("camera")[:300, :300] * 0.8 + 20
    scene[100:150, 100:160] = 400.0
    before, after = (np.clip(np.rint(scene + rng.normal(0, 2, scene.shape)), 0, 255) for _ in "ab")
    result = changes_between(before, after, options=ChangeOptions(white_level_dn=(255.0, 255.0)))
    assert not result.valid[105:145, 105:155].any()
    assert result.valid[20:80, 20:80].all()
    assert result.summary.changes == ()


@pytest.mark.slow
def test_what_is_brighter_than_white_is_a_change_of_at_least_so_much() -> None:
    rng = np.random.default_rng(2)
    scene = shipped("camera")[:300, :300] * 0.7 + 20
    lamp = scene.copy()
    lamp[200:210, 200:210] = 900.0
    before, after = (
        np.clip(np.rint(one + rng.normal(0, 2, scene.shape)), 0, 255) for one in (scene, lamp)
    )
    options = ChangeOptions(white_level_dn=(255.0, 255.0))
    found = changes_between(before, after, options=options).summary
    assert len(found.changes) == 1
    assert found.changes[0].amplitude_dn > 255 - scene[200:210, 200:210].max() - 5


@pytest.mark.slow
def test_where_the_ends_leave_nothing_it_is_said() -> None:
    dots = np.zeros((160, 160))
    dots[::6, ::6] = 255.0
    dots[3::6] = 100.0
    # Half a pixel aside every place is within reach of both ends.
    aside = np.eye(3)
    aside[:2, 2] = 0.5
    options = ChangeOptions(pose=at_rest((160, 160), aside), white_level_dn=(255.0, 255.0))
    with pytest.raises(OverlapError, match="clipped or next to clipped pixels"):
        changes_between(dots, dots, options=options)


def drawn_from_aside(drawing: FloatArray, pose: FloatArray) -> FloatArray:
    """The drawing as a scanner of two levels sees it at another pose, by OpenCV."""
    large = cv2.resize(drawing, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    seen = cv2.warpPerspective(
        cv2.GaussianBlur(large, (0, 0), 2.0),
        pose @ np.diag([1 / 3, 1 / 3, 1.0]),
        drawing.shape[::-1],
        borderValue=255,
    )
    return np.where(seen > 127, 255.0, 0.0)


@pytest.mark.slow
def test_two_drawings_from_aside_are_compared_beside_the_steps_of_their_outlines() -> None:
    turned = np.array([[0.97, -0.034, 7.0], [0.034, 0.97, -3.0], [1e-5, 2e-5, 1.0]])
    drawing = chart()
    spotted = drawing.copy()
    assert (drawing[70:80, 80:90] == 255).all()
    spotted[70:80, 80:90] = 0.0
    step_dn = np.ones(drawing.shape, dtype=np.float32)
    options = ChangeOptions(white_level_dn=(255.0, 255.0), step_dn=(step_dn, step_dn))
    before = drawn_from_aside(drawing, np.eye(3))
    same, other = (
        changes_between(before, drawn_from_aside(one, turned), options=options).summary
        for one in (drawing, spotted)
    )
    # Without the steps, every second outline had changed: 24 entries.
    assert len(same.changes) <= 1
    assert len(other.changes) <= 2
    first = other.changes[0]
    x, y, scale = turned @ (84.5, 74.5, 1.0)
    assert (first.x_px, first.y_px) == pytest.approx((x / scale, y / scale), abs=2)


@pytest.mark.slow
def test_a_drawing_whose_lines_moved_by_themselves_has_the_pose_at_which_most_did_not() -> None:
    rng = np.random.default_rng(5)
    before = np.full((220, 220), 255.0)
    places = [(20 + 50 * i, 20 + 50 * j) for i in range(4) for j in range(4)]
    after = before.copy()
    for row, col in places:
        before[row : row + 24, col : col + 30] = 0.0
        down, right = rng.integers(-1, 2, 2)
        after[row + down : row + 24 + down, col + right : col + 30 + right] = 0.0
    after[100:108, 6:14] = 0.0
    step_dn = np.ones(before.shape, dtype=np.float32)
    options = ChangeOptions(white_level_dn=(255.0, 255.0), step_dn=(step_dn, step_dn))
    found = changes_between(before, after, options=options).summary
    assert np.allclose(found.homography, np.eye(3), atol=1e-3)
    (one,) = found.changes
    assert np.hypot(one.x_px - 9.5, one.y_px - 103.5) < 3
    assert one.area_px < 120


@pytest.mark.slow
def test_a_line_of_one_pixel_that_is_gone_from_a_copy_of_a_drawing_is_found() -> None:
    before = chart()
    after = before.copy()
    before[200:230, 300] = 0.0
    assert (after[195:235, 295:306] == 255).all()
    options = ChangeOptions(white_level_dn=(255.0, 255.0))
    (line,) = changes_between(before, after, options=options).summary.changes
    assert line.x_px == pytest.approx(300, abs=1.5)
    assert 200 <= line.y_px < 230


PICTURES = ("camera", "coins", "moon", "page", "brick", "text")


@lru_cache
def picture(name: str) -> FloatArray:
    """Levels from 100 to 2100, none of them at an end."""
    levels = shipped(name)[:400, :400]
    return 100 + 2000 * levels / 255


def noisy(scene: FloatArray, noise_dn: float, seed: int) -> FloatArray:
    return scene + np.random.default_rng(seed).normal(0, noise_dn, scene.shape)


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("noise_dn", [3.0, 30.0])
def test_equal_exposures_are_as_sharp_and_as_bright_and_nothing_changed(
    name: str, noise_dn: float
) -> None:
    scene = picture(name)
    found = changes_between(noisy(scene, noise_dn, 1), noisy(scene, noise_dn, 2)).summary
    assert found.homography == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    # 12 pairs, drawn once: 3.9 standard errors are exceeded in one of 10,000.
    assert abs(found.extra_blur_px2) < 3.9 * found.extra_blur_err_px2
    assert abs(found.gain - 1) < 3.9 * found.gain_err
    assert (found.changes, found.moved) == ((), ())


@pytest.mark.slow
def test_a_mask_is_no_hint_of_the_pose() -> None:
    mask = np.zeros(picture("coins").shape, dtype=np.bool_)
    mask[:40] = True
    options = ChangeOptions(hints=RegistrationHints(left_out=mask), left_out=mask)
    result = changes_between(
        noisy(picture("coins"), 3.0, 1), noisy(picture("coins"), 3.0, 2), None, options
    )
    assert result.summary.homography == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert not result.valid[:40].any()


@pytest.mark.slow
def test_the_stated_errors_of_blur_and_gain_are_those_of_the_draws() -> None:
    ratios = []
    for seed in range(24):
        scene = picture(PICTURES[seed % len(PICTURES)])[:240, :240]
        # Of unequal noise, too: the mean is weighted by it.
        pair = noisy(scene, 20.0, 100 + seed), noisy(scene, 20.0 + 20 * (seed // 6 % 2), 200 + seed)
        found = changes_between(*pair).summary
        ratios.append(
            (found.extra_blur_px2 / found.extra_blur_err_px2, (found.gain - 1) / found.gain_err)
        )
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    # The root of chi-squared of 24 over 24: 0.56 to 1.49 in 999 of 1,000.
    assert (rms > 0.56).all()
    assert (rms < 1.49).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_photograph_does_not_differ_from_itself(name: str) -> None:
    scene = np.rint(picture(name) / 10)
    result = changes_between(scene, scene)
    assert not result.difference_dn.any()
    assert result.summary.gain == 1.0
    assert result.summary.extra_blur_px2 == pytest.approx(0, abs=1e-6)
    assert (result.summary.changes, result.summary.warnings) == ((), ())


@pytest.mark.slow
def test_before_against_after_is_minus_after_against_before() -> None:
    scene = picture("coins")
    before, after = noisy(scene, 10.0, 1), noisy(scene, 10.0, 2)
    after[200:206, 220:228] += 300.0
    there, back = changes_between(before, after), changes_between(after, before)
    scale = float(np.abs(there.difference_dn).max())
    # The light is fitted to one of them: to a few parts in a thousand of what changed.
    np.testing.assert_allclose(there.difference_dn, -back.difference_dn, atol=5e-3 * scale)
    assert len(there.summary.changes) == len(back.summary.changes) == 1


@pytest.mark.slow
def test_a_true_blur_and_a_true_gain_are_measured() -> None:
    scene = picture("camera")
    softer = 1.2 * gaussian_filter(scene, np.sqrt(0.5), truncate=7) + 30
    found = changes_between(noisy(scene, 8.0, 1), noisy(softer, 8.0, 2)).summary
    # At whole pixels the Gaussian has a variance of 0.497.
    assert found.extra_blur_px2 == pytest.approx(0.5, abs=4 * found.extra_blur_err_px2 + 0.02)
    assert found.gain == pytest.approx(1.2, abs=4 * found.gain_err + 1e-3)


@pytest.mark.slow
def test_a_part_cut_out_at_whole_pixels_is_compared_pixel_by_pixel() -> None:
    scene = np.rint(picture("camera") / 10)
    result = changes_between(scene, scene[31:331, 17:347])
    assert result.summary.homography == ((1.0, 0.0, 17.0), (0.0, 1.0, 31.0), (0.0, 0.0, 1.0))
    assert not result.difference_dn.any()


def test_another_view_is_aligned() -> None:
    scene = picture("camera")
    moved = noisy(np.roll(scene, 3, axis=1), 5.0, 2)
    assert one_view(noisy(scene, 5.0, 1), moved, ChangeOptions()) is None
    other = noisy(picture("brick"), 5.0, 3)
    assert one_view(noisy(scene, 5.0, 1), other, ChangeOptions()) is None


@pytest.mark.parametrize(
    ("matrix", "shift"),
    [
        (((1.0, 0.0, 16.9), (0.0, 1.0, -3.2), (0.0, 0.0, 1.0)), (-3, 17)),
        (((1.01, 0.0, 16.9), (0.0, 1.01, -3.2), (0.0, 0.0, 1.0)), None),
        (((1.0, 0.02, 0.0), (-0.02, 1.0, 0.0), (0.0, 0.0, 1.0)), None),
    ],
)
def test_the_nearest_shift_is_that_of_whole_pixels(
    matrix: tuple[tuple[float, ...], ...], shift: tuple[int, int] | None
) -> None:
    pose = DistortedPose(
        matrix=np.array(matrix), k1=0.0, reference_shape=(200, 300), followup_shape=(150, 200)
    )
    assert nearest_shift(pose) == shift
