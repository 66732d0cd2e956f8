import numpy as np
import pytest

from simulation import GaussianPsf, LensOtf, MeasuredPsf, PoseOptions
from simulation.choices import PoseModel
from simulation.uncertainty import KnownErrors, SimulatedView, pixel_uncertainty
from tests.simulation.exact_photographs import Optics, photographed

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
@pytest.mark.parametrize("model", ["matched", "lmmse"])
@pytest.mark.parametrize("zoom", [1.25, 1.5])
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
