"""The PSF from two distances, on scenes whose photographs are known in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.blind import pair_psf
from calibration.blind.two_distance import PairPsf, combined
from calibration.errors import PairError
from simulation.arrays import FloatArray
from tests.calibration.blob_scene import blob_photograph, far_to_near

TILTED = np.array([[0.45, 0.06], [0.06, 0.33]])


def elements(pair: PairPsf) -> FloatArray:
    return np.asarray(pair.covariance_px2[[0, 0, 1], [0, 1, 1]])


@pytest.fixture(scope="module")
def near() -> FloatArray:
    return blob_photograph(1.0, TILTED)


@pytest.fixture(scope="module")
def far() -> FloatArray:
    return blob_photograph(2.0, TILTED)


def test_a_tilted_psf_is_found_without_noise(near: FloatArray, far: FloatArray) -> None:
    pair = pair_psf(near, far, far_to_near(2.0))
    assert pair.zoom == pytest.approx(2.0, abs=1e-3)
    np.testing.assert_allclose(elements(pair), [0.45, 0.06, 0.33], rtol=0.01)


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
    pair = pair_psf(blob_photograph(1.0, psf), blob_photograph(zoom, psf), far_to_near(zoom))
    np.testing.assert_allclose(np.sqrt(np.diag(pair.covariance_px2)), [x, y], rtol=0.02)


@pytest.mark.slow
def test_noise_widens_nothing_where_it_is_known_and_its_errors_are_right(
    near: FloatArray, far: FloatArray
) -> None:
    rng = np.random.default_rng(3)
    scaled, plain = [], []
    for _ in range(8):
        noisy, other = (image + rng.normal(0, 20, image.shape) for image in (near, far))
        pair = pair_psf(noisy, other, far_to_near(2.0), near_noise_dn2=400.0)
        errs = np.sqrt(np.diag(pair.covariance_err_px2))
        scaled.append((elements(pair) - [0.45, 0.06, 0.33]) / errs)
        plain.append(pair_psf(noisy, other, far_to_near(2.0)).covariance_px2[0, 0])
    # 24 errors in units of their own; those of the three elements are about independent.
    assert 0.6 < np.sqrt(np.mean(np.square(scaled))) < 1.6
    assert np.mean(plain) > 1.05 * 0.45


@pytest.mark.slow
def test_vignetting_and_distortion_are_taken_up(near: FloatArray) -> None:
    bent = blob_photograph(2.0, TILTED, bend=0.01)
    y, x = np.mgrid[-1:1:240j, -1:1:320j]
    pair = pair_psf(near, bent * (1 - 0.1 * (x**2 + y**2)), far_to_near(2.0))
    np.testing.assert_allclose(elements(pair), [0.45, 0.06, 0.33], rtol=0.03)


def test_photographs_from_one_distance_are_refused(near: FloatArray) -> None:
    with pytest.raises(PairError) as refused:
        pair_psf(near, near, far_to_near(1.02))
    assert refused.value.reason == "one_distance"


@pytest.mark.slow
def test_a_far_photograph_that_is_too_sharp_is_refused(near: FloatArray) -> None:
    sharp = blob_photograph(2.0, 0.02 * np.eye(2))
    with pytest.raises(PairError) as refused:
        pair_psf(near, sharp, far_to_near(2.0))
    assert refused.value.reason == "sharp"


def test_photographs_that_hardly_overlap_are_refused(near: FloatArray, far: FloatArray) -> None:
    aside = far_to_near(2.0) + np.array([[0, 0, 600.0], [0, 0, 0], [0, 0, 0]])
    with pytest.raises(PairError) as refused:
        pair_psf(near, far, aside)
    assert refused.value.reason == "little_overlap"


def test_pairs_are_weighted_by_their_errors_and_disagreement_counts(
    near: FloatArray, far: FloatArray
) -> None:
    pair = pair_psf(near, far, far_to_near(2.0))
    mean, errors = combined([pair])
    np.testing.assert_allclose(mean, elements(pair))
    np.testing.assert_allclose(errors, pair.covariance_err_px2)
    both, fewer = combined([pair, pair])
    np.testing.assert_allclose(both, elements(pair))
    np.testing.assert_allclose(fewer, pair.covariance_err_px2 / 2)


def test_pairs_that_disagree_widen_the_error_by_how_much() -> None:
    def pair(xx: float) -> PairPsf:
        return PairPsf(
            zoom=2.0,
            covariance_px2=np.diag([xx, 0.4]),
            covariance_err_px2=np.diag([1e-4, 1e-4, 1e-4]),
        )

    # By hand: 0.05 off the mean each, five errors: chi^2 of 50 over three degrees of freedom.
    mean, errors = combined([pair(0.4), pair(0.5)])
    np.testing.assert_allclose(mean, [0.45, 0.0, 0.4])
    np.testing.assert_allclose(errors, np.eye(3) * 0.5e-4 * 50 / 3)
    with pytest.raises(ValueError):
        combined([])
