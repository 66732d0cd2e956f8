"""The judge's optics beside closed forms, GalSim and pyBSM."""

from dataclasses import replace
from math import ceil, cos, pi, radians, sin, sqrt

import numpy as np
import pytest
from scipy.special import ndtr

from benchmarks.truth.lenses import (
    Camera,
    astigmatic,
    defocused_pupil_otf,
    edge_photographs,
    edge_response,
    elsewhere,
    f_number,
    further,
    gaussian,
)
from simulation.arrays import FloatArray

ROUND_LENSES = [
    f_number(2.8),
    f_number(5.6),
    f_number(11),
    f_number(2.8, defocus_waves=1.0),
    f_number(5.6, defocus_waves=0.5),
]
STEP_PX = 0.25


def point_spread(camera: Camera, side: int, period_px: int) -> FloatArray:
    """Middle of the PSF, at every quarter of a pixel, shape ``(side, side)``, odd.

    Samples that far apart fold the frequencies beyond 2 cy/px back: each has the sum of both. The
    period folds the halo of an Airy disk back, 64 px by less than 1e-5 of its peak.
    """
    steps = round(period_px / STEP_PX)
    folds = ceil(2 * camera.cut_off_cy_per_px * STEP_PX)
    freq: FloatArray = np.fft.fftfreq(steps * folds, STEP_PX / folds).astype(np.float64)
    otf = camera.otf(freq[None, :], freq[:, None])
    otf = otf.reshape(folds, steps, folds, steps).sum(axis=(0, 2))
    psf = np.fft.fftshift(np.fft.ifft2(otf).real)
    middle = slice(steps // 2 - side // 2, steps // 2 + side // 2 + 1)
    return np.asarray(psf[middle, middle])


def galsim_psf(camera: Camera, side: int) -> FloatArray:
    galsim = pytest.importorskip("galsim", reason="the independent renderer is not installed")
    optics = galsim.OpticalPSF(
        lam_over_diam=1 / camera.cut_off_cy_per_px,
        # Zernike's defocus is sqrt(3) (2 r^2 - 1): its range over the pupil is 2 sqrt(3).
        defocus=camera.defocus_waves / (2 * sqrt(3)),
        oversampling=2,
        pad_factor=4,
    )
    if camera.stretch != ((1.0, 0.0), (0.0, 1.0)):
        (xx, xy), (yx, yy) = camera.stretch
        optics = galsim.Transform(optics, jac=(xx, xy, yx, yy), flux_ratio=1 / (xx * yy - xy * yx))
    image = galsim.Convolve(optics, galsim.Pixel(1.0)).drawImage(
        nx=side, ny=side, scale=STEP_PX, method="no_pixel"
    )
    return np.asarray(image.array, dtype=np.float64)


@pytest.mark.slow
@pytest.mark.parametrize(
    "camera",
    [*ROUND_LENSES, astigmatic(5.6, ratio=1.6, axis_deg=30)],
    ids=lambda camera: camera.name,
)
def test_the_psf_is_that_of_galsim(camera: Camera) -> None:
    ours, theirs = point_spread(camera, 65, 64), galsim_psf(camera, 65)
    assert np.abs(ours - theirs).max() < 1e-3 * ours.max()


@pytest.mark.parametrize("number", [2.8, 5.6, 11])
def test_a_lens_in_focus_is_the_closed_form_and_pybsm_s(number: float) -> None:
    camera = f_number(number)
    v = np.linspace(0, 1, 301)[:-1]
    closed = 2 / pi * (np.arccos(v) - v * np.sqrt(1 - v * v))
    assert defocused_pupil_otf(v, 0.0) == pytest.approx(closed, abs=1e-9)
    fx = v * camera.cut_off_cy_per_px * cos(radians(20))
    fy = v * camera.cut_off_cy_per_px * sin(radians(20))
    # The table's steps: linear between 4000 of them.
    assert camera.otf(fx, fy) == pytest.approx(closed * np.sinc(fx) * np.sinc(fy), abs=1e-6)
    pybsm = pytest.importorskip("pybsm.otf", reason="pip install --no-deps pybsm")
    aperture = pybsm.circular_aperture_OTF(
        u=fx[None, :], v=fy[None, :], lambda0=1.0, D=camera.cut_off_cy_per_px, eta=0.0
    )
    detector = pybsm.detector_OTF(u=fx[None, :], v=fy[None, :], w_x=1.0, w_y=1.0, f=1.0)
    assert camera.otf(fx, fy) == pytest.approx((aperture * detector)[0].real, abs=1e-6)


def test_a_defocused_lens_is_the_autocorrelation_of_its_pupil() -> None:
    """Brute force on a grid of 1601 points across the pupil: right to 1e-3."""
    points = np.linspace(-1, 1, 1601)
    x, y = points[None, :], points[:, None]
    for shift_steps in (160, 400, 800):
        shift = shift_steps * (points[1] - points[0])
        pupil = np.where(x * x + y * y <= 1, np.exp(2j * pi * 0.8 * (x * x + y * y)), 0)
        overlap = (pupil[:, shift_steps:] * pupil[:, :-shift_steps].conj()).sum()
        expected = overlap.real / (np.abs(pupil) ** 2).sum()
        found = defocused_pupil_otf(np.array(shift / 2), 0.8)
        assert found == pytest.approx(expected, abs=1e-3)


def test_an_edge_of_a_gaussian_camera_is_the_normal_distribution() -> None:
    distance = np.linspace(-60, 60, 997)
    found = edge_response(gaussian(0.8, has_pixel=False), 33.0, distance)
    # The other edge of the bar is 4096 px away; the spline has 64 knots a pixel.
    assert found == pytest.approx(ndtr(distance / 0.8), abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("normal_deg", [0.0, 31.0, 77.0])
def test_a_soft_edge_is_the_psf_times_the_soft_step(normal_deg: float) -> None:
    """A step blurred by half a pixel is band-limited: a sum over samples is its integral."""
    lens = f_number(5.6, defocus_waves=0.5)
    psf = point_spread(lens, 801, 256)
    places = (np.arange(801) - 400) * STEP_PX
    along = np.add.outer(places * sin(radians(normal_deg)), places * cos(radians(normal_deg)))
    distance = np.array([0.3, 1.7, 6.0])
    found = edge_response(replace(lens, sigma_px=0.5), normal_deg, distance)
    for place, value in zip(distance, found, strict=True):
        # Beyond 100 px there is 1e-3 of the light, as much on either side of the edge.
        beyond = 1 - psf.sum()
        expected = np.sum(psf * ndtr((place - along) / 0.5)) + beyond / 2
        assert value == pytest.approx(expected, abs=1e-4)


def test_a_turned_camera_at_twice_the_distance_is_the_further_one_turned() -> None:
    camera = astigmatic(5.6, ratio=1.6, axis_deg=30)
    c, s = cos(0.4), sin(0.4)
    turned = elsewhere(camera, 2 * np.array([[c, -s], [s, c]]))
    fx, fy = np.array([0.1, 0.3]), np.array([0.2, -0.05])
    # A frequency of the scene has the follow-up's direction after turning back.
    expected = further(camera, 2.0)(c * fx + s * fy, -s * fx + c * fy)
    assert turned(fx, fy) == pytest.approx(expected, abs=1e-12)


def test_photographs_of_edges_have_the_noise_that_was_asked_for() -> None:
    photographs = edge_photographs(f_number(5.6), [10.0, 100.0], 80, snr=100.0, seed=3)
    clean = edge_photographs(f_number(5.6), [10.0, 100.0], 80, snr=1e12, seed=3)
    first = photographs[0] - clean[0]
    # 6400 pixels: the deviation's own is 0.9 %.
    assert first.std() == pytest.approx(1.2, rel=0.04)
