"""Edges that are short, near the border, crossed or faint: found, and as sure as they say."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import EdgeImage, EdgeMeasurement, least_side_px, measure_edges
from calibration.errors import NoEdgeError
from calibration.psf import calibrate_psf
from simulation.arrays import FloatArray
from tests.calibration.closed_form import pixel_edge
from tests.calibration.squares import crossing, square_cover

LOW_DN, HIGH_DN = 8_000.0, 40_000.0
CONTRAST_DN = HIGH_DN - LOW_DN


def square(
    side_px: float, turn_deg: float, sigma_px: float, centre: tuple[float, float] = (0.3, -0.2)
) -> FloatArray:
    """A dark square in the middle of a bright image, with a margin of 25 px."""
    size = int(1.42 * side_px) + 50
    middle = (size - 1) / 2
    where = (middle + centre[0], middle + centre[1])
    return HIGH_DN - CONTRAST_DN * square_cover(where, side_px, turn_deg, sigma_px, (size, size))


def used(image_dn: FloatArray) -> list[EdgeMeasurement]:
    edges = measure_edges(EdgeImage(name="short", image_dn=image_dn))
    return [edge for edge in edges if edge.is_used and edge.optical_sigma_px is not None]


def deviations(edges: list[EdgeMeasurement], sigma_px: float) -> list[float]:
    """Errors of the optical widths over their standard errors."""
    return [
        (edge.optical_sigma_px - sigma_px) / edge.optical_sigma_err_px
        for edge in edges
        if edge.optical_sigma_px is not None and edge.optical_sigma_err_px is not None
    ]


@pytest.mark.slow
@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
@pytest.mark.parametrize("side_px", [22.0, 25.0, 30.0])
def test_all_sides_of_small_squares_are_measured(side_px: float, sigma_px: float) -> None:
    rng = np.random.default_rng(5)
    errors, count = [], 0
    for turn_deg in (0.0, 0.5, 8.0, 26.565, 45.0, *rng.uniform(0.0, 90.0, 5)):
        image = square(side_px, turn_deg, sigma_px, tuple(rng.uniform(-0.5, 0.5, 2)))
        edges = used(image + rng.normal(0.0, CONTRAST_DN / 100, image.shape))
        count += len(edges)
        errors += [abs((e.optical_sigma_px or 0.0) / sigma_px - 1) for e in edges]
    assert count >= 39  # of 40
    assert np.median(errors) < 0.01  # 0.3 to 0.7 % by the Cramer-Rao bound


@pytest.mark.slow
def test_sides_of_22_px_are_within_their_errors_at_the_stated_rate() -> None:
    rng = np.random.default_rng(8)
    found: list[float] = []
    for _ in range(40):
        image = square(22.0, rng.uniform(0.0, 90.0), 0.7, tuple(rng.uniform(-0.5, 0.5, 2)))
        edges = used(image + rng.normal(0.0, CONTRAST_DN / 100, image.shape))
        found += deviations(edges, 0.7)
    assert len(found) >= 157  # of 160
    # Of 160 edges 2.5 % fall outside by chance in 1 of 1000 trials if 15 or fewer are inside.
    assert np.mean(np.abs(found) < 1.96) > 0.89
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=0.19)  # 3.3 / sqrt(2 n)


@settings(max_examples=15, deadline=None)
@given(turn=st.floats(0.0, 90.0), sigma=st.floats(0.5, 2.0))
def test_the_corners_do_not_move_the_width_of_the_shortest_sides(turn: float, sigma: float) -> None:
    image = square(np.ceil(least_side_px(sigma)) + 1, turn, sigma)
    noise = np.random.default_rng(2).normal(0.0, CONTRAST_DN / 1000, image.shape)
    edges = used(image + noise)
    assert len(edges) >= 3
    for edge in edges:
        # 0.2 % of standard error at SNR 1000; the corners' part is well below.
        assert edge.optical_sigma_px == pytest.approx(sigma, rel=0.012)


@pytest.mark.parametrize(("side_px", "sigma_px"), [(16.0, 1.5), (20.0, 2.5)])
def test_the_message_tells_a_side_that_is_long_enough(side_px: float, sigma_px: float) -> None:
    too_small = EdgeImage(name="small", image_dn=square(side_px, 20.0, sigma_px))
    with pytest.raises(NoEdgeError, match=r"too short: .* at least \d+ px long") as error:
        calibrate_psf([too_small])
    told_px = float(str(error.value).split("at least ")[1].split(" px")[0])
    assert side_px < told_px < side_px + 8
    assert len(used(square(told_px, 20.0, sigma_px))) == 4


@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
@pytest.mark.parametrize("turned", [False, True])
def test_an_edge_2_px_from_the_border_is_measured(sigma_px: float, turned: bool) -> None:
    rng = np.random.default_rng(4)
    found: list[float] = []
    for _ in range(20):
        normal = np.deg2rad(rng.uniform(-2.0, 2.0))
        y, x = np.mgrid[:100, :80].astype(np.float64)
        # The edge comes within 2 px of the first column's outer side.
        nearest = 1.5 + abs(np.tan(normal)) * 49.5
        distance = np.cos(normal) * (x - nearest) + np.sin(normal) * (y - 49.5)
        image = LOW_DN + CONTRAST_DN * pixel_edge(distance, sigma_px, normal, nodes=6)
        image += rng.normal(0.0, CONTRAST_DN / 100, image.shape)
        [edge] = used(image.T[:, ::-1].copy() if turned else image)
        found += deviations([edge], sigma_px)
    # Chance of 4 or more of 20 beyond two standard errors: 1 in 60; of 5 or more: 1 in 400.
    assert sum(abs(z) > 1.96 for z in found) <= 4
    assert max(np.abs(found)) < 4


@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
def test_a_contrast_of_5_to_4_at_snr_30_is_measured(sigma_px: float) -> None:
    rng = np.random.default_rng(6)
    found: list[float] = []
    for turn_deg in rng.uniform(0.0, 90.0, 8):
        cover = square_cover((44.5, 45.2), 50.0, turn_deg, sigma_px, (90, 90))
        image = 10_000.0 - 2_000.0 * cover + rng.normal(0.0, 2_000.0 / 30, (90, 90))
        found += deviations(used(image), sigma_px)
    assert len(found) == 32
    assert sum(abs(z) > 1.96 for z in found) <= 6  # 1.6 expected; 7 or more: 1 in 1000
    assert max(np.abs(found)) < 4


@settings(max_examples=12, deadline=None)
@given(first=st.floats(0.0, 180.0), between=st.floats(50.0, 130.0), seed=st.integers(0, 99))
def test_edges_that_cross_are_measured_on_both_sides_of_the_crossing(
    first: float, between: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    a, b = crossing((first, first + between), tuple(rng.uniform(-5.0, 5.0, 2)), 0.8)
    for image in (a + 0.7 * b, a * b + (1 - a) * (1 - b)):
        edges = used(LOW_DN + 20_000.0 * image + rng.normal(0.0, 200.0, a.shape))
        assert len(edges) == 4
        # Each is 40 px long or so: 0.6 % of standard error, and 4 of 5 thousand edges beyond 4.
        assert max(np.abs(deviations(edges, 0.8))) < 5


def test_a_line_across_an_edge_interrupts_it() -> None:
    a, b = crossing((3.0, 80.0), (0.0, -3.0), 0.8)
    _, c = crossing((3.0, 80.0), (0.0, 3.0), 0.8)
    line = b - c
    image = (LOW_DN + CONTRAST_DN * a) * (1 - line) + 4_000.0 * line
    rng = np.random.default_rng(3)
    edges = used(image + rng.normal(0.0, 300.0, image.shape))
    steep = [edge for edge in edges if edge.orientation == "vertical"]
    assert len(steep) == 2
    assert min(edge.y_px for edge in steep) < 50 < 60 < max(edge.y_px for edge in steep)
    assert max(np.abs(deviations(steep, 0.8))) < 4


@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
def test_sides_whose_corners_lie_near_the_border_bear_no_false_remarks(sigma_px: float) -> None:
    rng = np.random.default_rng(7)
    found: list[float] = []
    for _ in range(8):
        # A square whose sides come within 2 px of the frame's outer pixels.
        cover = square_cover((44.5, 44.5), 84.0, rng.uniform(-1.0, 1.0), sigma_px, (90, 90))
        image = LOW_DN + CONTRAST_DN * cover + rng.normal(0.0, CONTRAST_DN / 100, cover.shape)
        edges = used(image)
        assert len(edges) == 4
        # Of 32 sides of whole photographs, remarks by chance: 3 of 1000.
        assert not any({"outliers", "shaded", "non_gaussian"} & set(edge.flags) for edge in edges)
        found += deviations(edges, sigma_px)
    assert sum(abs(z) > 1.96 for z in found) <= 6  # 1.6 expected; 7 or more: 1 in 1000
    assert max(np.abs(found)) < 4


@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
def test_an_edge_with_a_clipped_side_is_remarked_and_as_sure_as_it_says(sigma_px: float) -> None:
    rng = np.random.default_rng(9)
    found: list[float] = []
    for turn_deg in rng.uniform(0.0, 90.0, 10):
        cover = square_cover((49.5, 50.2), 60.0, turn_deg, sigma_px, (100, 100))
        high_dn = 400.0 + 3_695.0 / (1 - rng.uniform(0.01, 0.08))
        image = 400.0 + (high_dn - 400.0) * cover + rng.normal(0.0, 37.0, cover.shape)
        stored = np.clip(np.rint(image), 0.0, 4_095.0)
        edges = measure_edges(EdgeImage(name="clipped", image_dn=stored, saturation_dn=4_095.0))
        assert len(edges) == 4
        assert all("clipped" in edge.flags and edge.is_used for edge in edges)
        found += deviations(edges, sigma_px)
    assert len(found) == 40
    assert sum(abs(z) > 1.96 for z in found) <= 7  # 2 expected; 8 or more: 1 in 1000
    assert max(np.abs(found)) < 4.5
