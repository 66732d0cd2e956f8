from dataclasses import replace

import numpy as np
import pytest

from calibration.edges import (
    EdgeImage,
    EdgeMeasurement,
    EdgeSamples,
    edge_samples,
    find_edges,
    fit_edge,
    measure_edges,
    roughness_px,
)
from tests.calibration.closed_form import edge_image, point_edge


def measured(image: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> EdgeMeasurement:
    [edge] = measure_edges(EdgeImage(name="edge.tif", image_dn=image, saturation_dn=65_535.0))
    return edge


def rough_edge(amplitude_px: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """An upright edge whose place swings by a sine of 16 px along it."""
    y, x = np.mgrid[:96, :90].astype(np.float64)
    middle = 44.3 + 0.06 * (y - 48) + amplitude_px * np.sin(2 * np.pi * y / 16)
    return np.asarray(8_000 + 44_000 * point_edge(x - middle, 0.9))


def test_a_straight_edge_has_no_roughness_and_a_wavy_one_that_of_its_wave() -> None:
    straight = measured(edge_image(0.8, 5.0)).roughness_px
    assert straight == pytest.approx(0.0, abs=1e-6)
    # A sine of 0.2 px has an rms of 0.141; means over 4 of its 16 px take 10 % off (sinc 1/4).
    wavy = measured(rough_edge(0.2)).roughness_px
    assert wavy == pytest.approx(0.2 / np.sqrt(2) * np.sinc(1 / 4), rel=0.15)


def test_noise_is_not_taken_for_roughness() -> None:
    rng = np.random.default_rng(1)
    clean = edge_image(0.8, 5.0)
    rough = [measured(clean + rng.normal(size=clean.shape) * 880).roughness_px for _ in range(10)]
    # At an SNR of 50 a piece of 4 px is placed to 0.013 px: with the noise taken out in squares,
    # half of the edges are left with nothing and the others with a part of that.
    assert np.median([r for r in rough if r is not None]) < 0.008


def test_another_edge_nearby_limits_the_band() -> None:
    image = edge_image(0.8, 5.0)
    [segment] = find_edges(image, cell_px=1000.0)
    fit = fit_edge(image, segment)
    assert fit is not None
    free = edge_samples(image, segment, fit, 8.0).distance_px
    limited = edge_samples(image, replace(segment, clearance_px=4.0), fit, 8.0).distance_px
    assert 7.0 < np.abs(free).max() <= 8.0 + 1e-3
    assert 3.0 < np.abs(limited).max() <= 4.0 + 1e-3  # the bend is taken out of the distance


def test_contrast_is_michelsons_of_the_two_levels() -> None:
    # By hand: 8000 and 52000 DN differ by 44 in 60.
    assert measured(edge_image(0.8, 5.0)).contrast == pytest.approx(44 / 60, rel=1e-4)


def test_the_clipped_fraction_counts_both_ends() -> None:
    image = edge_image(0.8, 5.0)
    assert measured(image).clipped_fraction == 0.0
    bright = EdgeImage(name="b", image_dn=np.minimum(image, 50_000.0), saturation_dn=50_000.0)
    [edge] = measure_edges(bright)
    assert edge.clipped_fraction is not None
    assert 0.3 < edge.clipped_fraction < 0.5
    assert edge.flags == ("clipped",)
    unknown = measure_edges(EdgeImage(name="u", image_dn=image))[0]
    assert unknown.clipped_fraction is None


def test_a_clipped_edge_has_a_width_and_says_why_it_has_no_contrast_by_frequency() -> None:
    image = np.minimum(edge_image(0.8, 5.0), 50_000.0)
    [edge] = measure_edges(EdgeImage(name="b", image_dn=image, saturation_dn=50_000.0))
    assert edge.is_used
    assert edge.esfr is None
    assert edge.binned is None
    assert edge.esfr_missing == "pixels beside the edge are clipped"


def test_an_edge_clipped_far_below_its_level_is_kept_with_its_flag() -> None:
    image = np.minimum(edge_image(0.8, 5.0), 35_000.0)
    [edge] = measure_edges(EdgeImage(name="b", image_dn=image, saturation_dn=35_000.0))
    assert "saturated" in edge.flags
    assert not edge.is_used


def test_pixels_clipped_in_any_colour_reject_the_edge() -> None:
    image = edge_image(0.8, 5.0)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    source = EdgeImage(name="c", image_dn=image, saturation_dn=65_535.0, clipped=(x > 70) & (y > 0))
    # Clipped pixels 15 px away do not matter to the fit.
    assert measure_edges(source)[0].is_used
    near = EdgeImage(name="c", image_dn=image, saturation_dn=65_535.0, clipped=(x > 56) & (y > 0))
    [edge] = measure_edges(near)
    assert edge.flags[0] == "saturated"


def test_fewer_than_four_pieces_tell_no_roughness() -> None:
    # An edge of 10 px: two whole pieces of 4 px, and a rest.
    along, distance = (axis.ravel() for axis in np.mgrid[-5.0:5.0:0.5, -4.0:4.0:0.25])
    short = EdgeSamples(
        distance_px=distance,
        along_px=along,
        levels_dn=100 + 900 * point_edge(distance, 0.8),
        low_dn=100.0,
        high_dn=1000.0,
        normal_rad=0.1,
        half_length_px=5.0,
    )
    assert roughness_px(short, 0.8) is None
    longer = replace(short, along_px=2 * along, half_length_px=10.0)
    assert roughness_px(longer, 0.8) == pytest.approx(0.0, abs=1e-3)
