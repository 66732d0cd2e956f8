"""The models for lenses of all kinds beside Fourier optics, without and with a border."""

from math import ceil, floor

import numpy as np
import pytest

from simulation import GaussianPsf, LensOtf, MeasuredPsf, Model, Psf, SamplingGrid, zoom_out_on_grid
from tests.simulation.exact_photographs import (
    FloatArray,
    Optics,
    ideal_estimate,
    photographed,
)

GREEN_PER_PITCH = 0.55 / 8.3
MARGIN_PX = 48

SHARP = Optics(cut_off_px=(2.8 * GREEN_PER_PITCH, 0.0, 2.8 * GREEN_PER_PITCH))
SOFT = Optics(cut_off_px=(11 * GREEN_PER_PITCH, 0.0, 11 * GREEN_PER_PITCH))
DEFOCUSED = Optics(
    cut_off_px=(5.6 * GREEN_PER_PITCH, 0.0, 5.6 * GREEN_PER_PITCH), defocus_waves=0.5
)
# f/4 and f/9 along axes turned by 30 degrees.
ASTIGMATIC = Optics(cut_off_px=(0.3479, -0.1435, 0.5136))
GAUSSIAN = Optics(sigma_px=0.7)
LENSES = {
    "f/2.8": SHARP,
    "f/11": SOFT,
    "out of focus": DEFOCUSED,
    "astigmatic": ASTIGMATIC,
    "Gaussian": GAUSSIAN,
}


def psf_of(optics: Optics) -> Psf:
    if optics.cut_off_px is None:
        return GaussianPsf(sigma_x_px=optics.sigma_px, sigma_y_px=optics.sigma_px)
    waves2 = optics.defocus_waves**2
    lens = LensOtf(cut_off_period_px=optics.cut_off_px, defocus_waves2=(waves2, 0.0, waves2))
    return MeasuredPsf(lens=lens, gaussian=GaussianPsf(sigma_x_px=0.55, sigma_y_px=0.55))


def middle_mse(image: FloatArray, truth: FloatArray, zoom: float) -> float:
    margin = round(MARGIN_PX / zoom)
    return float(np.mean((image - truth)[margin:-margin, margin:-margin] ** 2))


def simulated(
    near: FloatArray, shape: tuple[int, ...], psf: Psf, zoom: float, model: Model
) -> FloatArray:
    grid = SamplingGrid(
        zoom_y=zoom, zoom_x=zoom, origin_y_px=0.0, origin_x_px=0.0, rows=shape[0], cols=shape[1]
    )
    return np.asarray(zoom_out_on_grid(near, grid, psf, model), dtype=np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("zoom", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("lens", LENSES)
def test_lmmse_is_as_good_as_the_ideal_and_no_worse_than_matched(lens: str, zoom: float) -> None:
    optics = LENSES[lens]
    near, far = photographed(0, optics, 1.0), photographed(0, optics, zoom)
    ideal = middle_mse(ideal_estimate(near, optics, zoom), far, zoom)
    lmmse, matched = (
        middle_mse(simulated(near, far.shape, psf_of(optics), zoom, model), far, zoom)
        for model in ("lmmse", "matched")
    )
    assert lmmse <= 1.1 * (ideal + 0.01)  # 1.03 at most were measured
    assert lmmse <= 1.01 * matched + 0.001
    assert matched <= 3.0 * (ideal + 0.01)  # 2.3 at most, astigmatic at zoom 3


@pytest.mark.slow
@pytest.mark.parametrize("noise_dn", [0.5, 1.5])
@pytest.mark.parametrize("sigma_px", [0.7, 1.2])
def test_noise_in_the_reference_does_lmmse_no_more_harm_than_matched(
    sigma_px: float, noise_dn: float
) -> None:
    optics = Optics(sigma_px=sigma_px)
    near, far = photographed(0, optics, 1.0), photographed(0, optics, 3.0)
    near = near + noise_dn * np.random.default_rng(2).standard_normal(near.shape)
    lmmse, matched = (
        middle_mse(simulated(near, far.shape, psf_of(optics), 3.0, model), far, 3.0)
        for model in ("lmmse", "matched")
    )
    assert lmmse <= max(1.01 * matched, matched + 0.001)


@pytest.mark.slow
def test_a_lens_whose_axes_are_exchanged_is_far_off() -> None:
    near, far = photographed(0, ASTIGMATIC, 1.0), photographed(0, ASTIGMATIC, 2.0)
    right = psf_of(ASTIGMATIC)
    xx, xy, yy = ASTIGMATIC.cut_off_px or (0.0, 0.0, 0.0)
    for mistaken in ((yy, xy, xx), (xx, -xy, yy)):
        wrong = psf_of(Optics(cut_off_px=mistaken))
        errors = [
            middle_mse(simulated(near, far.shape, psf, 2.0, "lmmse"), far, 2.0)
            for psf in (right, wrong)
        ]
        assert errors[1] > 1.5 * errors[0]  # 1.9 and more were measured


@pytest.mark.slow
@pytest.mark.parametrize("zoom", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("noise_dn", [0.0, 0.5])
@pytest.mark.parametrize("sigma_px", [0.7, 1.2])
def test_the_outermost_ring_of_a_cut_out_is_no_worse_than_matched(
    sigma_px: float, noise_dn: float, zoom: float
) -> None:
    optics = Optics(sigma_px=sigma_px)
    near, far = photographed(1, optics, 1.0), photographed(1, optics, zoom)
    near = near + noise_dn * np.random.default_rng(1).standard_normal(near.shape)
    first, rows, cols = ceil(24 / zoom), floor(96 / zoom), floor(120 / zoom)
    # As SamplingGrid.centred lies in an image: no whole far pixel is left around the grid.
    top = floor(first * zoom - (zoom - 1) / 2)
    bottom, right = (floor((first + n - 1) * zoom + zoom / 2) for n in (rows, cols))
    origin = first * zoom - top
    grid = SamplingGrid(
        zoom_y=zoom, zoom_x=zoom, origin_y_px=origin, origin_x_px=origin, rows=rows, cols=cols
    )
    cut = near[top : bottom + 1, top : right + 1]
    truth = far[first : first + rows, first : first + cols]
    rms = []
    for model in ("lmmse", "matched"):
        off = zoom_out_on_grid(cut, grid, psf_of(optics), model) - truth
        off[1:-1, 1:-1] = 0
        rms.append(float(np.sqrt(np.sum(off**2) / (2 * (rows + cols) - 4))))
    assert rms[0] <= 0.8 * rms[1]
