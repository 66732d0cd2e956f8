"""Edges that are short, near the border, crossed or faint: found, and as sure as they say.

Sides of squares in closed form, whose frame is near.
"""

import math
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from benchmarks.studies.edge_sides import SidesTally, Square, measured, square_along_pixels
from benchmarks.truth.edges import Rectangle, patches
from calibration.edges import (
    EdgeImage,
    EdgeMeasurement,
    EdgeSamples,
    EdgeSelection,
    edges_of_image,
    find_edges,
    fit_edge,
    least_side_px,
    mean_transfer,
)
from calibration.edges.measurement import BIN_PX, _lsf_fit, _told_apart
from calibration.errors import NoEdgeError, PsfFileError
from calibration.psf import PsfCalibration, psf_of_images
from calibration.psf._covariance import median_width
from hil_mocks import BenchTruth
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image, pixel_edge
from tests.calibration.edge_photographs import photographs
from tests.calibration.known import known
from tests.calibration.squares import chart, crossing, square_cover
from tests.hil_mocks.benches import bench_config


def calibrated(*normals_deg: float) -> PsfCalibration:
    sources = [
        EdgeImage(name=f"{n:g}", image_dn=edge_image(0.7 if n < 45 else 0.5, n, has_pixel=True))
        for n in normals_deg
    ]
    return psf_of_images(sources)


@pytest.mark.slow
def test_the_measured_transfer_is_the_product_of_lens_and_pixel() -> None:
    transfer = calibrated(2.0, 92.0).measured_transfer("psf.json")
    freq = np.linspace(0, 1, 21)
    for along, sigma in ((transfer.along_x, 0.7), (transfer.along_y, 0.5)):
        truth = np.exp(-2 * (np.pi * sigma * freq) ** 2) * np.sinc(freq)
        # 2 degrees off the axis the square is hardly another one.
        np.testing.assert_allclose(along(freq), truth, atol=2e-3)


def test_an_axis_without_edges_has_no_transfer() -> None:
    for psf in (calibrated(2.0), PsfCalibration(sigma_x_px=0.8)):
        with pytest.raises(PsfFileError) as refused:
            psf.measured_transfer("lens.json")
        assert (refused.value.source, refused.value.key) == ("lens.json", "transfer.y")
    assert mean_transfer([]) is None


def test_samples_that_are_no_transfer_function_are_refused() -> None:
    curve = {"freq_cy_per_px": [0.0, 0.3], "mtf": [1.0, 0.5]}
    psf = PsfCalibration.model_validate({"transfer": {"x": curve, "y": curve}})
    with pytest.raises(PsfFileError) as refused:
        psf.measured_transfer("lens.json")
    assert (refused.value.source, refused.value.key) == ("lens.json", "transfer.y")


@pytest.mark.parametrize("sigma_px", [0.4, 0.5, 0.7, 1.0, 1.5])
def test_the_bias_is_that_of_the_bin_and_the_difference(sigma_px: float) -> None:
    # Closed form: a bin of h and a difference over 2 h add h^2 / 12 + (2 h)^2 / 12.
    expected = sqrt(sigma_px**2 + 5 * BIN_PX**2 / 12)
    widths = [
        edges_of_image(EdgeImage(name="e", image_dn=edge_image(sigma_px, normal)), method="paper")[
            0
        ].sigma_px
        for normal in (3.0, 5.0, 8.0, 11.0, 97.0, 103.0)
    ]
    # How the pixels' places beat with the bins moves single edges by up to 3 % at 0.4 px.
    np.testing.assert_allclose(widths, expected, rtol=0.035 if sigma_px < 0.6 else 0.015)
    assert np.median(widths) == pytest.approx(expected, rel=0.01)


def test_the_bias_at_half_a_pixel_is_five_percent() -> None:
    sources = [EdgeImage(name=f"{n}", image_dn=edge_image(0.5, n)) for n in (4.0, 7.0, 94.0, 97.0)]
    psf = psf_of_images(sources, method="paper")
    assert psf.sigma_x_px == pytest.approx(0.5 * 1.051, rel=0.01)
    assert psf.sigma_y_px == pytest.approx(0.5 * 1.051, rel=0.01)


def test_widths_are_medians_and_nothing_optical_and_no_rho_is_told() -> None:
    psf = psf_of_images(photographs([2.0, 5.0, 8.0, 45.0, 93.0]), method="paper")
    upright = [e.sigma_px for e in psf.edges if e.orientation == "vertical"]
    assert psf.sigma_x_px == np.median(upright)
    assert psf.method == "paper"
    assert psf.rho is None
    assert psf.covariance_px2 is None
    assert psf.optical_sigma_x_px is None
    assert psf.field is None
    assert all(edge.optical_sigma_px is None for edge in psf.edges)
    assert all(edge.chi2_reduced is None for edge in psf.edges)


def test_diagonal_edges_alone_determine_nothing_in_the_papers_way() -> None:
    psf = psf_of_images(photographs([45.0, 135.0]), method="paper")
    assert psf.sigma_x_px is None
    assert psf.sigma_y_px is None


def test_the_error_of_a_median_by_hand() -> None:
    # MAD of (1, 2, 3, 4, 10) about 3 is 1: err = sqrt(pi/2) / 0.6745 / sqrt(5).
    median = median_width(np.array([1.0, 2.0, 3.0, 4.0, 10.0]), np.ones(5))
    assert median.value == 3.0
    assert median.err == pytest.approx(sqrt(np.pi / 2) / 0.67449 / sqrt(5), rel=1e-4)
    assert median.high - median.value == pytest.approx(1.96 * median.err, rel=1e-3)
    assert median_width(np.array([0.7]), np.array([0.02])).err == 0.02
    with pytest.raises(ValueError):
        median_width(np.array([]), np.array([]))


@pytest.mark.parametrize(
    ("reach_px", "rise"),
    [
        pytest.param(0.7, 1.0, id="seven bins"),
        pytest.param(8.0, 0.0, id="no edge at all"),
        pytest.param(8.0, 1 / 16, id="a ramp over the whole band"),
    ],
)
def test_pixels_that_tell_no_width_have_none(reach_px: float, rise: float) -> None:
    image = edge_image(0.8, 5.0)
    fit = known(fit_edge(image, find_edges(image)[0]))
    distance = np.linspace(-reach_px, reach_px, 2000)
    samples = EdgeSamples(
        distance_px=distance,
        along_px=np.zeros_like(distance),
        levels_dn=100 + 900 * (0.5 + rise * distance),
        low_dn=100.0,
        high_dn=1000.0,
        normal_rad=0.1,
        half_length_px=30.0,
    )
    assert _lsf_fit(samples, fit) is None


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
    edges = edges_of_image(EdgeImage(name="short", image_dn=image_dn))
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
        psf_of_images([too_small])
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
        edges = edges_of_image(EdgeImage(name="clipped", image_dn=stored, saturation_dn=4_095.0))
        assert len(edges) == 4
        assert all("clipped" in edge.flags and edge.is_used for edge in edges)
        found += deviations(edges, sigma_px)
    assert len(found) == 40
    assert sum(abs(z) > 1.96 for z in found) <= 7  # 2 expected; 8 or more: 1 in 1000
    assert max(np.abs(found)) < 4.5


def test_the_closed_form_of_a_square_is_its_quadrature() -> None:
    square = Rectangle(x_px=20.3, y_px=17.9, half_px=(9.2, 6.1), angle_rad=0.0, level_dn=3.0)
    shape = 36, 42
    expected = patches(shape, [square], 0.0, 0.9)
    # Four nodes a pixel are exact to 1e-6 at sigma 0.5, and beyond 7 sigma nothing is added.
    np.testing.assert_allclose(square_along_pixels(square, shape, 0.9), expected, atol=1e-6)


@pytest.mark.slow
def test_no_side_along_the_pixels_is_lost_and_its_width_is_exact_without_noise() -> None:
    rng = np.random.default_rng(11)
    tally = SidesTally()
    for sigma_px in (0.4, 0.7, 1.0, 1.4, 1.9, 2.5, 3.0):
        for angle_deg in (0.0, 0.5, 1.0):
            for snr in (math.inf, math.inf, 500.0, 100.0):
                square = Square.drawn(rng, sigma_px, angle_deg, snr)
                tally.add(square, measured(square.image_dn(rng)))
    assert tally.sides == 336
    # Before, noise of the arithmetic lost one in 80 of the sides without noise.
    assert tally.lost == []
    assert tally.worst < 5e-5, tally.worst_name


ROWS, COLS = 240, 340
WHITE_DN, BLACK_DN, GREY_DN = 40_000.0, 6_000.0, 22_000.0


def chart_in_a_room() -> EdgeImage:
    """A chart of squares on the left, and on the right steep grey stripes of the scene."""
    image = np.full((ROWS, COLS), WHITE_DN)
    image[:, :240] -= (WHITE_DN - BLACK_DN) * chart(ROWS, 240)
    y, x = np.mgrid[:ROWS, :COLS].astype(np.float64)
    ramp = np.clip((x - 0.35 * y - 215.0) / 2.0, 0.0, 1.0)
    image += (GREY_DN - image) * ramp
    image += np.random.default_rng(3).normal(0.0, 200.0, image.shape)
    return EdgeImage(name="room", image_dn=image)


def test_an_edge_of_the_scene_is_kept_with_a_flag_and_does_not_count() -> None:
    source = chart_in_a_room()
    edges = EdgeSelection().measured_in(source, "all-angles")
    scene = [edge for edge in edges if "beside_target" in edge.flags]
    assert scene
    assert not any(edge.is_used for edge in scene)
    assert all(edge.x_px > 210 for edge in scene)
    assert sum(edge.is_used for edge in edges) >= 4 * 15


def test_with_all_every_edge_counts() -> None:
    source = chart_in_a_room()
    edges = EdgeSelection(target="all").measured_in(source, "all-angles")
    assert [repr(edge) for edge in edges] == [repr(edge) for edge in edges_of_image(source)]
    assert not any("beside_target" in edge.flags for edge in edges)


@pytest.mark.parametrize("pitch_px", [1, 2])
def test_a_chart_alone_is_the_target_in_the_pixels_of_any_plane(pitch_px: int) -> None:
    image = WHITE_DN - (WHITE_DN - BLACK_DN) * chart(240, 288, turn_deg=5.0, shear=12.0)
    image += np.random.default_rng(4).normal(0.0, 200.0, image.shape)
    source = EdgeImage(name="chart", image_dn=image, pitch_px=pitch_px)
    edges = _told_apart(edges_of_image(source), pitch_px)
    assert len(edges) >= 100  # 30 squares
    assert not any("beside_target" in edge.flags for edge in edges)


@pytest.mark.parametrize("target", ["edge", "chart", "board"])
def test_no_good_edge_of_a_target_of_the_simulated_bench_is_thrown_away(target: str) -> None:
    bench = BenchTruth(bench_config(simulated__width_px=480, simulated__height_px=360))
    image = bench.expected_image_dn(target, 5.0, 150.0, exposure_us=4_000.0)
    image = image + np.random.default_rng(5).normal(0.0, 5.0, image.shape)
    edges = _told_apart(edges_of_image(EdgeImage(name=target, image_dn=image)))
    assert edges
    assert not any("beside_target" in edge.flags for edge in edges)
