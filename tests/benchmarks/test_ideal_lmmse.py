"""The ideal linear estimate beside the normal equations of a whole period."""

from math import pi

import numpy as np
import pytest

from benchmarks.truth.lens_scenes import CORRELATION_PX, Ideal, slanted_rectangles
from benchmarks.truth.lenses import elsewhere, f_number, further
from simulation.arrays import FloatArray

SHEARED = np.array([[1.6, 0.4], [-0.1, 2.1]])


@pytest.mark.parametrize("noise_dn", [0.3, 3.0])
def test_it_solves_the_normal_equations(noise_dn: float) -> None:
    """All covariances of a period of 12 px as sums over the scene's frequencies."""
    side = 12
    scene, camera = slanted_rectangles(side, 4, seed=0), f_number(8)
    far = elsewhere(camera, SHEARED)
    order = np.arange(-2 * side, 2 * side)
    fx, fy = (order / side)[None, :], (order / side)[:, None]
    spectrum = (
        2
        * pi
        * CORRELATION_PX**2
        * scene.variance_dn2
        / (1 + (2 * pi * CORRELATION_PX) ** 2 * (fx * fx + fy * fy)) ** 1.5
        / side**2
    )
    place = np.array([4.3, 7.9])
    otf = camera.otf(fx, fy)
    waves = np.exp(2j * pi * order[:, None] / side * np.arange(side))
    near_near = np.einsum("vu,vm,un->mn", otf * otf * spectrum, waves, waves).real
    to_place = np.exp(2j * pi * (fx * place[0] + fy * place[1]))
    far_near = np.einsum(
        "vu,vm,un->mn", far(fx, fy) * otf * spectrum * to_place, waves.conj(), waves.conj()
    ).real
    lag = np.arange(side)[:, None] - np.arange(side)
    covariance = near_near[lag[:, None, :, None] % side, lag[None, :, None, :] % side]
    covariance = covariance.reshape(side**2, side**2) + noise_dn**2 * np.eye(side**2)
    weights = np.linalg.solve(covariance, far_near.ravel())
    # The sum of the weights comes out below 1 with noise; the ideal has it at 1.
    reference = scene.reference(camera) - scene.reference(camera).mean()
    found = Ideal.of(scene, camera, noise_dn).seen(reference, far, place[None, :1], place[None, 1:])
    assert found[0] == pytest.approx(weights @ reference.ravel(), abs=2e-3)


def test_a_constant_stays() -> None:
    scene, camera = slanted_rectangles(32, 4, seed=0), f_number(5.6)
    found = Ideal.of(scene, camera, 2.0).seen(
        np.full((32, 32), 77.0), further(camera, 2.0), np.array([3.3]), np.array([5.1])
    )
    assert found[0] == pytest.approx(77.0, abs=1e-9)


def test_nothing_linear_beats_it_on_the_whole() -> None:
    """Scaled by a few percent at fine details, its error grows: it stands at a minimum."""
    scene, camera = slanted_rectangles(96, 6, seed=4), f_number(5.6)
    reference = scene.reference(camera)
    far = further(camera, 1.5)
    x = np.arange(0, 96, 1.5)
    truth = scene.seen(far, x[None, :], x[:, None])
    ideal = Ideal.of(scene, camera, 0.0)

    def error(gain: float) -> float:
        def tuned(fx: FloatArray, fy: FloatArray) -> FloatArray:
            return np.asarray(far(fx, fy) * (1 + gain * (np.hypot(fx, fy) > 0.35)))

        return float(np.mean((ideal.seen(reference, tuned, x[None, :], x[:, None]) - truth) ** 2))

    assert error(0.0) < error(0.15)
    assert error(0.0) < error(-0.15)
