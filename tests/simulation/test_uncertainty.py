"""Errors of simulated pairs in closed form, over designs of two levels."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation import GaussianPsf, LensOtf, MeasuredPsf, PoseOptions
from simulation.arrays import FloatArray
from simulation.choices import PoseModel
from simulation.uncertainty import (
    KnownErrors,
    PixelUncertainty,
    PsfStep,
    SimulatedView,
    _second_derivatives,
    pixel_uncertainty,
    principal_steps,
)
from tests.simulation.exact_photographs import Optics, photographed
from tests.simulation.poses import tilted
from tests.simulation.wave_scene import WaveScene

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
@pytest.mark.parametrize(("model", "which"), [("matched", 1), ("lmmse", 2)])
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


def test_the_derivatives_of_a_cosine_are_those_of_the_formula() -> None:
    # Whole half periods along either axis, as the mirror at the edges has them; not square.
    y, x = np.mgrid[0:40, 0:60] + 0.5
    a, b = np.pi * 7 / 60, np.pi * 5 / 40
    xx, xy, yy = _second_derivatives(np.cos(a * x) * np.cos(b * y))
    assert xx == pytest.approx(-(a**2) * np.cos(a * x) * np.cos(b * y), abs=1e-12)
    assert yy == pytest.approx(-(b**2) * np.cos(a * x) * np.cos(b * y), abs=1e-12)
    assert xy == pytest.approx(a * b * np.sin(a * x) * np.sin(b * y), abs=1e-12)


def test_colours_are_taken_one_by_one() -> None:
    planes = np.random.default_rng(0).normal(size=(9, 12, 3))
    whole = _second_derivatives(planes)
    for k in range(3):
        for all_planes, plane in zip(whole, _second_derivatives(planes[:, :, k]), strict=True):
            assert all_planes[:, :, k] == pytest.approx(plane, abs=1e-12)


CUT_OFF_PX = 0.37  # f/5.6 at 550 nm on pixels of 8.3 um
SHARP = MeasuredPsf(
    lens=LensOtf(cut_off_period_px=(CUT_OFF_PX, 0.0, CUT_OFF_PX)),
    gaussian=GaussianPsf(sigma_px=0.5),
)


def shifted(view: SimulatedView) -> SimulatedView:
    """The view whose first pixel lies on the reference's first, as the exact photographs."""
    matrix = view.matrix.copy()
    matrix[:2, 2] = 0.0
    options = PoseOptions(model="lmmse" if view.model == "lmmse" else "matched")
    return SimulatedView.of_pose(view.reference, matrix, view.size, options)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "zoom"), [("matched", 1.25), ("lmmse", 1.5)])
def test_the_stated_error_is_that_of_opaque_rectangles_to_a_third(
    model: PoseModel, zoom: float
) -> None:
    # Photographs by Fourier optics, without noise. An average over scenes of another kind.
    optics = Optics(cut_off_px=(CUT_OFF_PX, 0.0, CUT_OFF_PX))
    measured, stated = [], []
    for seed in range(3):
        near, far = photographed(seed, optics, 1.0), photographed(seed, optics, zoom)
        view = shifted(SimulatedView.at_zoom(near.shape, zoom, model))
        far = far[: view.size[1], : view.size[0]]
        found = pixel_uncertainty(view, near, SHARP, KnownErrors())
        assert found.model is not None
        inner = np.s_[12:-12, 12:-12]
        measured.append(((far - view.rendered(near, SHARP))[inner] ** 2).mean())
        stated.append(found.model[inner].mean())
    assert np.sqrt(np.mean(measured) / np.mean(stated)) == pytest.approx(1.0, abs=0.33)


def test_a_flat_scene_and_the_reference_itself_have_no_model_error() -> None:
    flat = np.full((40, 50), 100.0)
    view = SimulatedView.at_zoom(flat.shape, 1.5, "lmmse")
    found = pixel_uncertainty(view, flat, GaussianPsf(sigma_px=0.5), KnownErrors())
    assert found.model is not None
    assert found.model.max() == 0.0
    noisy = np.random.default_rng(0).normal(100, 20, flat.shape)
    same = SimulatedView.at_zoom(flat.shape, 1.0, "lmmse")
    kept = pixel_uncertainty(same, noisy, GaussianPsf(sigma_px=0.5), KnownErrors())
    assert kept.model is not None
    assert kept.model.max() == 0.0


def test_noise_that_is_known_is_no_structure_of_the_scene() -> None:
    noisy = np.random.default_rng(0).normal(100, 2, (60, 60))
    view = SimulatedView.at_zoom(noisy.shape, 1.5, "lmmse")
    psf = GaussianPsf(sigma_px=0.5)
    taken = pixel_uncertainty(view, noisy, psf, KnownErrors()).model
    known = pixel_uncertainty(view, noisy, psf, KnownErrors(noise_dn2=np.full((60, 60), 4.0))).model
    assert taken is not None
    assert known is not None
    assert known.mean() < 0.15 * taken.mean()


VALUES = np.array([0.75, 0.8, 0.1])


def covariance_of(steps: tuple[PsfStep, ...]) -> FloatArray:
    """The sum of the squares of the steps."""
    total = np.zeros((3, 3))
    for step in steps:
        sides = [
            np.array([psf.sigma_x_px, psf.sigma_y_px, psf.rho])
            for psf in (step.plus, step.minus)
            if isinstance(psf, GaussianPsf)
        ]
        one = (sides[0] - sides[1]) / step.length
        total += np.outer(one, one)
    return total


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6), zoom=st.floats(1.1, 3.0))
def test_independent_steps_add_up_to_the_covariance(seed: int, zoom: float) -> None:
    # Of widths whose errors are alike, all directions matter, and the steps are the covariance.
    root = np.random.default_rng(seed).normal(size=(3, 3)) + 2 * np.eye(3)
    covariance = 1e-6 * root @ root.T
    found = covariance_of(principal_steps(psf_of, VALUES, covariance, zoom))
    # Directions left out hold 1e-3 of what the follow-up shows.
    assert np.trace(found) == pytest.approx(np.trace(covariance), rel=0.2)
    assert np.all(np.linalg.eigvalsh(covariance - found) > -1e-9 * np.trace(covariance))


def test_a_direction_that_changes_nothing_is_left_out() -> None:
    assert principal_steps(psf_of, VALUES, np.zeros((3, 3)), 2.0) == ()
    # A width known a thousand times better than the other.
    (step,) = principal_steps(psf_of, VALUES, np.diag([1e-4, 1e-10, 0.0]), 2.0)
    assert isinstance(step.plus, GaussianPsf)
    assert step.plus.sigma_y_px == pytest.approx(0.8, abs=1e-3)


def test_where_one_side_is_no_psf_the_other_is_taken() -> None:
    def bounded(values: FloatArray) -> GaussianPsf:
        if values[0] < 0.75:
            raise ValueError("too narrow")
        return psf_of(values)

    (step,) = principal_steps(bounded, VALUES, np.diag([1e-4, 0.0, 0.0]), 2.0)
    sides = {step.plus, step.minus}
    assert psf_of(VALUES) in sides
    assert max(p.sigma_x_px for p in sides if isinstance(p, GaussianPsf)) == pytest.approx(
        0.75 + 0.01 * step.length
    )
