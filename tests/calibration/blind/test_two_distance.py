"""The PSF from two distances, on scenes whose photographs are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import ndtr

from calibration.blind import NearAndFar, pair_psf, two_distance
from calibration.blind._lens_estimate import GaussianElements
from calibration.blind._resampled_pair import ResampledPair
from calibration.blind._transfer import PairModel
from calibration.blind.two_distance import ClippedPixels, combined, disagreement
from calibration.errors import PairError
from simulation.arrays import FloatArray
from tests.calibration.blob_scene import blob_photograph, far_to_near

TILTED = np.array([[0.45, 0.06], [0.06, 0.33]])


def both(near_dn: FloatArray, far_dn: FloatArray, noise_dn2: float | None = 0.0) -> NearAndFar:
    clipped = ClippedPixels.none(near_dn.shape, far_dn.shape)
    return NearAndFar(near_dn=near_dn, far_dn=far_dn, clipped=clipped, near_noise_dn2=noise_dn2)


@pytest.fixture(scope="module")
def near() -> FloatArray:
    return blob_photograph(1.0, TILTED)


@pytest.fixture(scope="module")
def far() -> FloatArray:
    return blob_photograph(2.0, TILTED)


def test_a_tilted_psf_is_found_without_noise(near: FloatArray, far: FloatArray) -> None:
    pair = pair_psf(both(near, far), far_to_near(2.0))
    assert pair.zoom == pytest.approx(2.0, abs=1e-3)
    np.testing.assert_allclose(pair.gaussian.px2, [0.45, 0.06, 0.33], rtol=0.02)


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(
    zoom=st.floats(1.4, 2.6),
    width=st.floats(0.5, 0.9),
    ratio=st.floats(0.8, 1.25),
    rho=st.floats(-0.3, 0.3),
)
def test_any_psf_is_found_at_any_zoom(zoom: float, width: float, ratio: float, rho: float) -> None:
    x, y = width * np.sqrt(ratio), width / np.sqrt(ratio)
    psf = np.array([[x * x, rho * x * y], [rho * x * y, y * y]])
    pair = pair_psf(both(blob_photograph(1.0, psf), blob_photograph(zoom, psf)), far_to_near(zoom))
    np.testing.assert_allclose(np.sqrt(pair.gaussian.px2[[0, 2]]), [x, y], rtol=0.02)


@pytest.mark.slow
def test_noise_widens_nothing_and_its_errors_are_right(near: FloatArray, far: FloatArray) -> None:
    rng = np.random.default_rng(3)
    scaled, untold = [], []
    for _ in range(6):
        noisy, other = (image + rng.normal(0, 20, image.shape) for image in (near, far))
        told = pair_psf(both(noisy, other, 400.0), far_to_near(2.0)).gaussian
        scaled.append((told.px2 - [0.45, 0.06, 0.33]) / np.sqrt(np.diag(told.covariance)))
        untold.append(pair_psf(both(noisy, other, None), far_to_near(2.0)).gaussian.px2)
    # 18 errors in units of their own; those of the three elements are about independent.
    assert 0.5 < np.sqrt(np.mean(np.square(scaled))) < 1.6
    # Where it is not known it is what the far photograph scatters by.
    np.testing.assert_allclose(np.mean(untold, axis=0)[[0, 2]], [0.45, 0.33], rtol=0.04)


@pytest.mark.slow
def test_noise_of_the_near_photograph_alone_is_no_blur(near: FloatArray, far: FloatArray) -> None:
    # Taken for what the whole resampled frame has, where the near one ends within it, it gave a
    # width of 0.25 px for 0.57; off a spectrum smoothed without its fall, 2 to 4 % too wide.
    found = []
    for seed in range(4):
        noisy = near + np.random.default_rng(seed).normal(0, 20.0, near.shape)
        found.append(pair_psf(both(noisy, far, 400.0), far_to_near(2.0)).gaussian.px2[[0, 2]])
    np.testing.assert_allclose(np.sqrt(np.mean(found, axis=0)), np.sqrt([0.45, 0.33]), rtol=0.02)


def tiles(zoom: float, var_px2: float) -> FloatArray:
    """Tiles of 12 near pixels along the pixel grid, through a Gaussian PSF, in closed form."""
    across = []
    for count in (240, 320):
        at, line = np.arange(count) - (count - 1) / 2, 12.0 * np.arange(-30, 31) / zoom
        passed = ndtr(np.subtract.outer(at, line) / np.sqrt(var_px2))
        across.append(passed[:, :-1] - passed[:, 1:])
    levels = np.random.default_rng(4).uniform(-800, 800, (60, 60))
    return np.asarray(1500 + across[0] @ levels @ across[1].T)


@pytest.mark.slow
def test_of_large_photographs_the_middle_is_measured(
    near: FloatArray, far: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(two_distance, "MOST_PIXELS", 11_000)  # of 19,200 that both show
    measured: list[int] = []

    class Counted(PairModel):
        def __init__(self, pair: ResampledPair, noise_dn2: float, codes: None) -> None:
            super().__init__(pair, noise_dn2, codes)
            measured.append(int(np.count_nonzero(pair.used)))

    monkeypatch.setattr(two_distance, "PairModel", Counted)
    found = pair_psf(both(near, far), far_to_near(2.0)).gaussian
    np.testing.assert_allclose(found.px2, [0.45, 0.06, 0.33], rtol=0.04)
    assert 9_000 < measured[0] < 12_000


@pytest.mark.slow
def test_noise_that_the_photographs_cannot_have_narrows_nothing(
    near: FloatArray, far: FloatArray
) -> None:
    found = pair_psf(both(near, far, 400.0), far_to_near(2.0)).gaussian
    np.testing.assert_allclose(found.px2, [0.45, 0.06, 0.33], rtol=0.02)


@pytest.mark.slow
def test_a_pattern_along_the_pixels_is_less_sure_than_its_scatter_says() -> None:
    # All of its edges lie at the same place between pixels, where a sharp lens aliases alike.
    near, far = (tiles(zoom, 0.12) for zoom in (1.0, 2.0))
    found = pair_psf(both(near, far), far_to_near(2.0))
    assert found.fit.repeated > 5
    sure = replace(found, fit=replace(found.fit, repeated=1.0))
    err, scatter = (np.sqrt(np.diag(one.gaussian.covariance))[[0, 2]] for one in (found, sure))
    assert np.all(err > 1.5 * scatter)
    assert np.all(np.abs(found.gaussian.px2[[0, 2]] - 0.12) < 3 * err)


@pytest.mark.slow
def test_errors_of_a_scene_of_many_places_do_not_repeat_themselves(
    near: FloatArray, far: FloatArray
) -> None:
    assert pair_psf(both(near, far), far_to_near(2.0)).fit.repeated < 1.1


@pytest.mark.slow
def test_vignetting_and_distortion_are_taken_up(near: FloatArray) -> None:
    bent = blob_photograph(2.0, TILTED, bend=0.01)
    y, x = np.mgrid[-1:1:240j, -1:1:320j]
    shaded = bent * (1 - 0.1 * (x**2 + y**2))
    pair = pair_psf(both(near, shaded), far_to_near(2.0))
    np.testing.assert_allclose(pair.gaussian.px2, [0.45, 0.06, 0.33], rtol=0.01)


def test_photographs_from_one_distance_are_refused(near: FloatArray) -> None:
    with pytest.raises(PairError) as refused:
        pair_psf(both(near, near), far_to_near(1.02))
    assert refused.value.reason == "one_distance"


@pytest.mark.slow
def test_a_far_photograph_that_is_too_sharp_is_refused(near: FloatArray) -> None:
    sharp = blob_photograph(2.0, 0.02 * np.eye(2))
    with pytest.raises(PairError) as refused:
        pair_psf(both(near, sharp), far_to_near(2.0))
    assert refused.value.reason == "sharp"


def test_photographs_that_hardly_overlap_are_refused(near: FloatArray, far: FloatArray) -> None:
    aside = far_to_near(2.0) + np.array([[0, 0, 600.0], [0, 0, 0], [0, 0, 0]])
    with pytest.raises(PairError) as refused:
        pair_psf(both(near, far), aside)
    assert refused.value.reason == "little_overlap"


def test_pairs_that_agree_have_smaller_errors(near: FloatArray, far: FloatArray) -> None:
    rng = np.random.default_rng(4)
    noisy, other = (image + rng.normal(0, 20, image.shape) for image in (near, far))
    pair = pair_psf(both(noisy, other, 400.0), far_to_near(2.0))
    alone, twice = combined([pair]).gaussian, combined([pair, pair]).gaussian
    np.testing.assert_allclose(twice.px2[[0, 2]], alone.px2[[0, 2]], rtol=0.03)
    assert np.all(np.diag(twice.covariance) < 0.7 * np.diag(alone.covariance))
    with pytest.raises(ValueError):
        combined([])


def test_pairs_that_disagree_widen_the_error_by_how_much() -> None:
    def found(xx: float) -> GaussianElements:
        return GaussianElements(px2=np.array([xx, 0.0, 0.4]), covariance=1e-4 * np.eye(3))

    # By hand: 0.05 off the mean each, five errors: chi^2 of 50 over three degrees of freedom.
    assert disagreement([found(0.4), found(0.5)]) == pytest.approx(50 / 3)
    assert disagreement([found(0.4), found(0.4)]) == 1.0
    assert disagreement([found(0.4)]) == 1.0
