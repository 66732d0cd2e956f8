"""Errors of simulated pairs in closed form, over designs of two levels.

Every input that is uncertain is one standard error off, to either side, in all combinations: the
mean square over these is the variance to first order, without the scatter of draws.
"""

from itertools import product

import numpy as np
import pytest

from simulation import GaussianPsf, PoseOptions
from simulation.arrays import FloatArray
from simulation.choices import PoseModel
from simulation.uncertainty import (
    KnownErrors,
    PixelUncertainty,
    SimulatedView,
    pixel_uncertainty,
    principal_steps,
)
from tests.simulation.poses import tilted
from tests.simulation.uncertainty.wave_scene import WaveScene

SHAPE = (72, 90)
SIGMA_PX = 0.8
SCATTER_PX2 = 0.04
COVARIANCE = np.array([[1.0, 0.4, 0.0], [0.4, 1.5, 0.2], [0.0, 0.2, 4.0]]) * 5e-5
INNER = np.s_[8:-8, 8:-8]


def psf_of(values: FloatArray) -> GaussianPsf:
    return GaussianPsf(*values.tolist())


def near_and_far(
    view: SimulatedView, blur_px2: tuple[float, float], seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Reference and follow-up whose PSFs have these variances; without noise."""
    scene, round_blur = WaveScene(seed), np.array([1.0, 0.0, 1.0])
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float64)
    seen = view.survey()
    near = scene.photographed(x, y, np.broadcast_to(blur_px2[0] * round_blur, (*SHAPE, 3)))
    return near, scene.photographed(seen[..., 0], seen[..., 1], blur_px2[1] * seen[..., 2:])


def views(model: PoseModel) -> list[SimulatedView]:
    size = (54, 42)
    # The middle of the frame, which the reference covers.
    middle = np.array([[1.0, 0.0, 18.0], [0.0, 1.0, 15.0], [0.0, 0.0, 1.0]])
    matrix = tilted(180.0, (SHAPE[1], SHAPE[0]), 15.0, 1.3) @ middle
    options = PoseOptions(model=model)
    pose = SimulatedView.of_pose(SHAPE, matrix, size, options)
    return [
        SimulatedView.at_zoom(SHAPE, 1.0, model),
        SimulatedView.at_zoom(SHAPE, 1.6, model),
        pose,
    ]


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_focus_that_is_off_by_its_scatter_is_as_far_off_as_is_said(
    model: PoseModel, which: int
) -> None:
    view, psf = views(model)[which], GaussianPsf(sigma_px=SIGMA_PX)
    squares, stated = [], []
    for signs in product((1, -1), repeat=2):
        variances = [SIGMA_PX**2 + sign * SCATTER_PX2 for sign in signs]
        near, far = near_and_far(view, (variances[0], variances[1]))
        found = pixel_uncertainty(view, near, psf, KnownErrors(focus_scatter_px2=SCATTER_PX2))
        assert found.focus is not None
        squares.append((far - view.rendered(near, psf))[INNER] ** 2)
        stated.append(found.focus[INNER])
    ratio = np.sqrt(np.mean(squares) / np.mean(stated))
    assert ratio == pytest.approx(1.0, abs=0.03)  # second order in the scatter


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
def test_a_psf_that_is_off_by_its_error_is_as_far_off_as_is_said(model: PoseModel) -> None:
    zoom = 1.6
    view, known = SimulatedView.at_zoom(SHAPE, zoom, model), np.array([SIGMA_PX, SIGMA_PX, 0.0])
    steps = principal_steps(psf_of, known, COVARIANCE, zoom)
    scene, seen = WaveScene(0), view.survey()
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float64)
    squares, stated = [], []
    for signs in product((1, -1), repeat=3):
        true = psf_of(known + np.linalg.cholesky(COVARIANCE) @ np.array(signs))
        blur_px2 = true.covariance_px2[[0, 0, 1], [0, 1, 1]]
        near = scene.photographed(x, y, np.broadcast_to(blur_px2, (*SHAPE, 3)))
        far_blur_px2 = np.broadcast_to(zoom**2 * blur_px2, seen[..., 2:].shape)
        far = scene.photographed(seen[..., 0], seen[..., 1], far_blur_px2)
        found = pixel_uncertainty(view, near, psf_of(known), KnownErrors(psf_steps=steps))
        assert found.psf is not None
        squares.append((far - view.rendered(near, psf_of(known)))[INNER] ** 2)
        stated.append(found.psf[INNER])
    assert np.sqrt(np.mean(squares) / np.mean(stated)) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
@pytest.mark.parametrize("which", [1, 2])
def test_all_sources_together_are_as_large_as_the_error_of_the_follow_up(
    model: PoseModel, which: int
) -> None:
    # The closed form shares no code with the model; drawn noise, and the design of two levels.
    view, rng = views(model)[which], np.random.default_rng(1)
    width_err_px, noise_dn = 0.008, 0.4
    known_noise = np.full(SHAPE, noise_dn**2)
    squares = []
    for signs in product((1, -1), repeat=3):
        variances = [SIGMA_PX**2 + sign * SCATTER_PX2 for sign in signs[:2]]
        near, far = near_and_far(view, (variances[0], variances[1]), seed=2)
        near += noise_dn * rng.normal(size=SHAPE)

        def round_of(values: FloatArray) -> GaussianPsf:
            return GaussianPsf(sigma_px=float(values[0]))

        width = np.array([SIGMA_PX + signs[2] * width_err_px])
        steps = principal_steps(round_of, width, np.array([[width_err_px**2]]), view.zoom)
        errors = KnownErrors(noise_dn2=known_noise, psf_steps=steps, focus_scatter_px2=SCATTER_PX2)
        found = pixel_uncertainty(view, near, round_of(width), errors)
        err = found.err_without_model
        assert err is not None
        squares.append(((far - view.rendered(near, round_of(width))) / err)[INNER] ** 2)
    # The noise of some 10,000 pixels leaves about 1 %.
    assert 0.95 < np.sqrt(np.mean(squares)) < 1.05


@pytest.mark.slow
def test_what_is_not_known_is_named_and_left_out() -> None:
    view = SimulatedView.at_zoom(SHAPE, 1.6, "paper")
    near, _ = near_and_far(view, (0.64, 0.64))
    psf = GaussianPsf(sigma_px=SIGMA_PX)
    nothing = pixel_uncertainty(view, near, psf, KnownErrors())
    assert nothing.unknown == ("noise", "psf", "focus", "model")
    assert nothing.err is None
    noise = pixel_uncertainty(view, near, psf, KnownErrors(noise_dn2=np.ones(SHAPE)))
    assert noise.unknown == ("psf", "focus", "model")
    assert noise.err is not None
    assert noise.noise is not None
    assert noise.err == pytest.approx(np.sqrt(noise.noise))


@pytest.mark.slow
def test_the_noise_of_a_pose_that_is_a_zoom_is_that_of_the_zoom() -> None:
    # Two code paths: the operator's squared weights, and their Fourier series.
    zoom = SimulatedView.at_zoom(SHAPE, 1.6, "matched")
    pose = SimulatedView.of_pose(
        SHAPE, zoom.matrix, zoom.size, PoseOptions(model="matched", origin_px=(0.0, 0.0))
    )
    variance = np.full(SHAPE, 2.0)
    psf = GaussianPsf(sigma_px=SIGMA_PX)
    exact = zoom.noise_variance(variance, psf)[INNER]
    assert pose.noise_variance(variance, psf)[INNER] == pytest.approx(exact, rel=0.02)


def test_more_light_scales_every_error() -> None:
    one = np.full((2, 3), 4.0)
    known = PixelUncertainty(noise=one, psf=None, focus=2 * one, model=one)
    lit = known.scaled(0.5)
    assert lit.psf is None
    assert known.err is not None
    assert lit.err is not None
    assert lit.err == pytest.approx(0.5 * known.err)


@pytest.mark.parametrize(
    "errors",
    [
        {"focus_scatter_px2": -0.1},
        {"focus_scatter_px2": float("nan")},
        {"noise_dn2": np.full(SHAPE, -1.0)},
    ],
)
def test_errors_that_cannot_be_are_refused(errors: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        KnownErrors(**errors)  # type: ignore[arg-type]  # wrong on purpose
