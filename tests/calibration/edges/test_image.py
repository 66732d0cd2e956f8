from dataclasses import replace
from functools import cache
from math import sqrt

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from calibration.choices import PATTERNS, Pattern
from calibration.edges import EdgeImage, EdgeSelection, Region, find_edges, fit_edge, plane_places
from calibration.edges._image import _optical_of_total, in_sensor_pixels
from calibration.errors import NoEdgeError
from calibration.psf import calibrate_mosaic
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image, pixel_edge
from tests.calibration.known import known

SIGMAS = {"red": 0.75, "green": 0.6, "blue": 0.9}


SHAPE = (180, 220)


@cache
def full_frame(colour: str, normal_deg: float) -> FloatArray:
    """The edge on a sensor of this colour alone; do not write to it."""
    return edge_image(SIGMAS[colour], normal_deg, shape=SHAPE, has_pixel=True)


def mosaic(normal_deg: float, pattern: Pattern = "GRBG") -> EdgeImage:
    """An edge on a sensor of colour pixels; each colour has its own optical width."""
    out = np.zeros(SHAPE)
    for place in plane_places(pattern):
        part = np.s_[place.first_y_px :: 2, place.first_x_px :: 2]
        gain = {"red": 0.6, "green": 1.0, "blue": 0.5}[place.colour]
        out[part] = gain * full_frame(place.colour, normal_deg)[part]
    return EdgeImage(name=f"raw-{normal_deg:g}.tif", image_dn=out)


def test_where_each_colour_of_a_pattern_begins() -> None:
    places = {(p.colour, p.first_x_px, p.first_y_px) for p in plane_places("GRBG")}
    assert places == {("green", 0, 0), ("red", 1, 0), ("blue", 0, 1), ("green", 1, 1)}
    assert [p.colour for p in plane_places("BGGR")] == ["blue", "green", "green", "red"]
    for pattern in PATTERNS:
        assert sorted(p.colour for p in plane_places(pattern)) == ["blue", "green", "green", "red"]
    with pytest.raises(ValueError):
        plane_places("RGBG")  # type: ignore[arg-type]


@pytest.mark.slow
def test_each_colour_gives_the_optical_width_behind_one_sensor_pixel() -> None:
    psf = calibrate_mosaic([mosaic(n) for n in (5.0, 95.0)], "GRBG")
    assert psf.channels is not None
    assert set(psf.channels) == {"red", "green", "blue"}
    for colour, one in psf.channels.items():
        # What the fit's window and weights do otherwise than plain least squares: 0.1 %.
        assert one.optical_sigma_x_px == pytest.approx(SIGMAS[colour], rel=0.001)
        assert one.optical_sigma_y_px == pytest.approx(SIGMAS[colour], rel=0.001)
        # Green has two planes; each shows one edge of each of the two photographs.
        assert one.edge_count == (4 if colour == "green" else 2)
    assert psf.total.sigma_x_px == psf.channels["green"].total.sigma_x_px
    assert psf.sigma_x_px == pytest.approx(sqrt(0.6**2 + 1 / 12), rel=0.005)


@pytest.mark.slow
def test_places_lengths_and_frequencies_are_in_pixels_of_the_sensor() -> None:
    psf = calibrate_mosaic([mosaic(5.0)], "GRBG", "red")
    [edge] = psf.edges
    turn = np.deg2rad(5.0)
    across = np.cos(turn) * (edge.x_px - 109.5) + np.sin(turn) * (edge.y_px - 89.5)
    assert across == pytest.approx(0.37, abs=0.01)
    assert edge.length_px == pytest.approx(180, abs=4)
    assert edge.esfr is not None
    # The transfer of the optical Gaussian and one sensor pixel, whatever the pitch is.
    assert edge.esfr.mtf50_cy_per_px == pytest.approx(edge.mtf50_cy_per_px, rel=0.003)


def test_a_region_is_given_in_pixels_of_the_sensor() -> None:
    whole = mosaic(5.0)
    upper = Region(x_px=0, y_px=0, width_px=220, height_px=80)
    psf = calibrate_mosaic([whole], "GRBG", selection=EdgeSelection(region=lambda _: upper))
    assert all(edge.y_px < 80 for edge in psf.edges)
    outside = Region(x_px=0, y_px=0, width_px=220, height_px=400)
    with pytest.raises(ValueError):
        calibrate_mosaic([whole], "GRBG", selection=EdgeSelection(region=lambda _: outside))


@pytest.mark.parametrize("normal_deg", [0.0, 12.0, 45.0, 100.0])
@pytest.mark.parametrize("optical_px", [0.3, 0.6, 1.2])
def test_the_optical_width_of_a_total_one_against_least_squares_on_the_closed_form(
    optical_px: float, normal_deg: float
) -> None:
    turn = float(np.deg2rad(normal_deg))
    distance = np.linspace(-12, 12, 1201)
    profile = pixel_edge(distance, optical_px, turn)
    total = minimize_scalar(
        lambda s: float(np.sum((profile - ndtr(distance / s)) ** 2)), bounds=(0.2, 3.0)
    ).x
    assert _optical_of_total(float(total), turn) == pytest.approx(optical_px, rel=2e-3)


def test_an_edge_as_sharp_as_the_pixel_has_no_optical_width() -> None:
    assert _optical_of_total(0.25, 0.1) is None


def test_a_colour_without_an_edge_is_named() -> None:
    flat = EdgeImage(name="flat.tif", image_dn=np.full((80, 80), 10.0))
    with pytest.raises(NoEdgeError) as refused:
        calibrate_mosaic([flat], "RGGB", "blue")
    assert refused.value.subject == "flat.tif (blue)"
    assert refused.value.found == 0


def test_an_edge_as_sharp_as_a_sensor_pixel_alone_has_no_optical_width() -> None:
    image = edge_image(0.8, 5.0)
    fit = known(fit_edge(image, find_edges(image)[0]))
    # 0.24 sensor px in all, where the square alone has sqrt(1/12) = 0.29.
    sharp = in_sensor_pixels(replace(fit, sigma_px=0.12), 2)
    assert sharp.sigma_px == pytest.approx(0.24)
    assert sharp.optical_sigma_px is None
    assert sharp.optical_sigma_err_px is None
    assert in_sensor_pixels(replace(fit, sigma_px=0.3), 2).optical_sigma_px is not None
