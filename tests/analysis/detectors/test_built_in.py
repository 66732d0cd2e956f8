from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra import numpy as npst
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

from analysis.detectors import BUILT_IN_DETECTORS, ir_mad_statistic, takes_colour
from analysis.detectors.built_in import FUNCTIONS, absolute_difference, changes, ir_mad, ncc, ssim
from simulation.arrays import Float32Array

SAME = np.eye(3)
SHAPE = (61, 47)


def texture(seed: int, shape: tuple[int, int] = SHAPE) -> Float32Array:
    """Smooth random levels about 100 with a standard deviation of some 12."""
    rng = np.random.default_rng(seed)
    return (100 + 60 * gaussian_filter(rng.standard_normal(shape), 1.5)).astype(np.float32)


def test_the_absolute_difference_of_a_step_is_the_step_behind_its_filter() -> None:
    # Levels that add up to nothing over any stretch of 4 px: the fit of light does not see it.
    before = texture(1, (160, 160))
    step = np.zeros((160, 160))
    step[80, 80] = 40.0
    found = absolute_difference(before, (before + step).astype(np.float32), SAME)
    # A single pixel of a Gaussian of 1 px in the middle: 1 / (2 pi) to 0.1 % of sampling; the fit
    # of light takes away less than 0.1 DN.
    assert found[80, 80] == pytest.approx(40 / (2 * np.pi), abs=0.1)
    assert found.argmax() == 80 * 160 + 80
    assert found[:60].max() < 0.1


def test_the_absolute_difference_is_blind_to_gain_and_offset() -> None:
    before = texture(2)
    found = absolute_difference(before, 1.7 * before - 20, SAME)
    assert found.max() < 1e-3  # float32 levels of 200 are stored to 1e-5


def test_a_translated_plane_wave_is_put_back() -> None:
    # A spline of degree 3 errs by 0.1 % at 16 px a period; the wave is one of (x, y), so that
    # exchanged axes or the inverse shift show.
    y, x = np.mgrid[:48, :64].astype(np.float64)
    moved = np.array([[1.0, 0, 2.25], [0, 1, -1.5], [0, 0, 1]])

    def wave(at_x: object, at_y: object) -> Float32Array:
        return np.asarray(
            100 + 20 * np.sin(2 * np.pi * (np.asarray(at_x) / 16 + np.asarray(at_y) / 29)),
            dtype=np.float32,
        )

    found = absolute_difference(wave(x, y), wave(x + 2.25, y - 1.5), moved)
    assert found[4:-4, 2:-6].max() < 0.2
    assert found[:, -2:].tolist() == [[0, 0]] * 48  # beyond the reference's last column
    assert found[0].tolist() == [0] * 64
    assert found[2:, :-3].max() > 0
    turned = np.linalg.inv(moved)
    assert absolute_difference(wave(x, y), wave(x + 2.25, y - 1.5), turned).max() > 10


def test_the_correlation_of_an_image_with_itself_is_1_and_with_its_negative_minus_1() -> None:
    before = texture(3)
    np.testing.assert_allclose(ncc(before, before, SAME), 0, atol=1e-6)
    np.testing.assert_allclose(ncc(before, 3 * before + 7, SAME), 0, atol=1e-5)
    np.testing.assert_allclose(ncc(before, 200 - before, SAME), 2, atol=1e-5)


def test_the_correlation_at_a_pixel_is_that_of_the_9_x_9_px_around_it() -> None:
    before, after = texture(4), texture(5)
    window = np.s_[20 - 4 : 20 + 5, 30 - 4 : 30 + 5]
    expected = 1 - np.corrcoef(before[window].ravel(), after[window].ravel())[0, 1]
    assert ncc(before, after, SAME)[20, 30] == pytest.approx(expected, abs=1e-6)


def test_flat_windows_agree_and_a_flat_one_has_nothing_of_a_textured_one() -> None:
    flat = np.full(SHAPE, 80, dtype=np.float32)
    assert ncc(flat, flat + 9, SAME).max() == 0
    np.testing.assert_allclose(ncc(flat, texture(6), SAME), 1, atol=1e-6)


def test_the_structural_similarity_is_scikit_images_own() -> None:
    before, after = texture(7).astype(np.float64), texture(8).astype(np.float64)
    span = max(before.max(), after.max()) - min(before.min(), after.min())
    own: Any = structural_similarity  # it states no types
    _, expected = own(before, after, data_range=span, gaussian_weights=True, full=True)
    found = ssim(before.astype(np.float32), after.astype(np.float32), SAME)
    np.testing.assert_allclose(found, 1 - expected, atol=1e-5)
    assert ssim(texture(7), texture(7), SAME).max() == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
@given(gain=st.floats(0.05, 20), offset=st.floats(-1000, 1000), sign=st.sampled_from((-1, 1)))
@settings(max_examples=20, deadline=None)
def test_ir_mad_does_not_depend_on_the_levels_of_either(
    gain: float, offset: float, sign: int
) -> None:
    before, after = texture(9).astype(np.float64), texture(10).astype(np.float64)
    after = before + 0.3 * (after - 100)
    everywhere = np.ones(SHAPE, dtype=np.bool_)
    plain = ir_mad_statistic(before, after, everywhere)
    mapped = ir_mad_statistic(sign * gain * before + offset, after, everywhere)
    np.testing.assert_allclose(mapped, plain, rtol=1e-3, atol=1e-3)


def test_ir_mad_without_change_is_chi_squared_with_nine_degrees_of_freedom() -> None:
    # Two photographs of noise alone share nothing: each round's variates are standardised, so
    # their mean is the number of bands but for what reweighting drops. First round: exactly 9.
    rng = np.random.default_rng(11)
    scene = 100 + 300 * gaussian_filter(rng.standard_normal((96, 96)), 3)
    before, after = (
        (scene + rng.standard_normal(scene.shape)).astype(np.float32) for _ in range(2)
    )
    quiet = np.median(ir_mad(before, after, SAME)[8:-8, 8:-8])
    assert 5 < quiet < 14  # the median of chi-squared with 9 is 8.34
    after[46:50, 46:50] += 15
    found = ir_mad(before, after, SAME)
    assert found[44:52, 44:52].max() == found[8:-8, 8:-8].max()
    assert found.max() > 60  # chi-squared beyond 60 has a probability of 1e-9


@pytest.mark.slow
def test_our_own_comparison_finds_a_spot_and_leaves_its_borders_at_0() -> None:
    rng = np.random.default_rng(12)
    scene = texture(13, (128, 128)).astype(np.float64)
    before, after = ((scene + rng.normal(0, 1, scene.shape)).astype(np.float32) for _ in range(2))
    after[60:65, 70:75] += 12
    found = changes(before, after, SAME)
    y, x = np.unravel_index(found.argmax(), found.shape)
    assert abs(y - 62) <= 2
    assert abs(x - 72) <= 2
    assert found.max() > 8
    assert found[:4].max() == found[:, -4:].max() == 0
    assert np.median(found[20:50, 20:50]) < 2  # of a standard normal's size: 0.67


@pytest.mark.slow
def test_our_own_comparison_of_flat_images_and_beyond_the_horizon_is_nothing() -> None:
    flat = np.full((64, 64), 80, dtype=np.float32)
    assert changes(flat, flat, SAME).max() == 0
    horizon = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0.04, -1]])
    assert changes(texture(14), texture(15), horizon).max() == 0


SIDES = st.integers(8, 64)
LEVELS = st.floats(0, 65535, width=32)


@st.composite
def images(draw: st.DrawFn, levels: st.SearchStrategy[float]) -> Float32Array:
    shape = draw(st.tuples(SIDES, SIDES))
    if draw(st.booleans()):
        return np.full(shape, draw(levels), dtype=np.float32)
    return draw(npst.arrays(np.float32, shape, elements=levels, fill=levels))


POSES = st.builds(
    lambda zoom, x, y, tilt: np.array([[zoom, 0.1, x], [-0.1, zoom, y], [tilt, 0, 1]]),
    st.floats(0.5, 2.5),
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-0.01, 0.01),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILT_IN_DETECTORS)
@given(data=st.data())
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
def test_any_finite_photographs_give_a_finite_map_of_the_followups_shape(
    name: str, data: st.DataObject
) -> None:
    levels = (
        LEVELS if name == "changes" else st.floats(width=32, allow_nan=False, allow_infinity=False)
    )
    before, after = data.draw(images(levels)), data.draw(images(levels))
    shown = (before, after)
    if takes_colour(FUNCTIONS[name]):
        shown = np.stack([before] * 3, axis=2), np.stack([after] * 3, axis=2)
    found = FUNCTIONS[name](*shown, data.draw(POSES))
    assert isinstance(found, np.ndarray)
    assert found.shape == after.shape
    assert found.dtype == np.float32
    assert np.isfinite(found).all()
    assert found.min() >= 0
