from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import EdgeSegment, find_edges
from calibration.edges._detection import beside_target
from simulation.arrays import BoolArray, FloatArray
from tests.calibration.closed_form import edge_image, point_edge
from tests.calibration.squares import square_cover


def square_image(
    turn_deg: float, side_px: float, shape: tuple[int, int] = (120, 140)
) -> FloatArray:
    """A dark square of ``side_px`` on white, turned about the middle of the image."""
    rows, cols = shape
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x -= (cols - 1) / 2
    y -= (rows - 1) / 2
    t = np.deg2rad(turn_deg)
    u, v = np.cos(t) * x + np.sin(t) * y, -np.sin(t) * x + np.cos(t) * y
    inside = np.ones(shape)
    for w in (u, -u, v, -v):
        inside *= point_edge(side_px / 2 - w, 0.8)
    return 200.0 - 150.0 * inside


@settings(max_examples=40, deadline=None)
@given(normal=st.floats(0.0, 360.0), sigma=st.floats(0.4, 2.5))
def test_an_edge_across_the_frame_is_found_at_any_angle(normal: float, sigma: float) -> None:
    segments = find_edges(edge_image(sigma, normal), cell_px=1000.0)
    assert len(segments) == 1
    turned = np.deg2rad(normal) - segments[0].normal_rad
    assert abs((turned + np.pi) % (2 * np.pi) - np.pi) < np.deg2rad(0.5)


@pytest.mark.parametrize("quarter_deg", [0.0, 180.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("off_axis_deg", [22.6, 23.5, 25.0])
def test_the_strongest_gradient_does_not_overflow_just_off_22_5_degrees(
    off_axis_deg: float, side: float, quarter_deg: float
) -> None:
    # cv2.Canny compares 79109 times the x gradient in 32 bits, for these directions only.
    assert len(find_edges(edge_image(1.0, quarter_deg + side * off_axis_deg))) == 1


@pytest.mark.parametrize("turn_deg", [0.0, 5.0, 33.0, 45.0, 80.0])
@pytest.mark.parametrize("side_px", [26.0, 60.0])
def test_the_four_sides_of_a_square_are_four_edges(turn_deg: float, side_px: float) -> None:
    segments = find_edges(square_image(turn_deg, side_px))
    assert len(segments) == 4
    distances = [np.hypot(s.x_px - 69.5, s.y_px - 59.5) for s in segments]
    np.testing.assert_allclose(distances, side_px / 2, atol=0.4)


def test_the_normal_points_to_the_bright_side() -> None:
    for segment in find_edges(square_image(10.0, 60.0)):
        outward = np.array([segment.x_px - 69.5, segment.y_px - 59.5])
        normal = np.array([np.cos(segment.normal_rad), np.sin(segment.normal_rad)])
        assert outward @ normal > 0


def test_a_long_edge_is_cut_into_pieces_that_cover_it_once() -> None:
    segments = find_edges(edge_image(0.8, 4.0, shape=(400, 80)), cell_px=100.0)
    assert len(segments) == 4
    assert sum(s.length_px for s in segments) == pytest.approx(400.0, abs=3.0)


def test_nothing_is_found_in_noise_on_a_flat_field_or_on_a_ramp() -> None:
    noise = np.random.default_rng(1).normal(1000.0, 30.0, (200, 300))
    assert find_edges(noise) == []
    assert find_edges(np.full((50, 60), 7.0)) == []
    # A ramp is as steep everywhere: it has no ridge.
    assert find_edges(np.tile(np.arange(60.0), (50, 1))) == []


def test_an_edge_at_snr_6_is_found() -> None:
    rng = np.random.default_rng(9)
    found = 0
    for _ in range(20):
        image = edge_image(0.8, 7.0) + rng.normal(0.0, 44_000.0 / 6, (90, 110))
        # Noise may break it into pieces; most of its 90 px must be there.
        found += sum(s.length_px for s in find_edges(image, cell_px=1000.0)) > 60.0
    assert found == 20


def test_a_band_between_two_edges_limits_the_window() -> None:
    bar = np.minimum(
        edge_image(0.8, 0.0, offset_px=-9.0), 60_000.0 - edge_image(0.8, 0.0, offset_px=9.0)
    )
    segments = find_edges(bar, cell_px=1000.0)
    assert len(segments) == 2
    for segment in segments:
        assert 8.0 < segment.clearance_px < 18.0


@pytest.mark.parametrize("normal_deg", [3.0, 40.0, 200.0])
def test_shot_noise_on_the_bright_side_is_no_second_edge(normal_deg: float) -> None:
    # 15 times the variance of the dark side, whose pixels set the scale of the noise.
    rng = np.random.default_rng(3)
    for _ in range(10):
        clean = edge_image(0.8, normal_deg, shape=(100, 100))
        variance = np.interp(clean, [8_000.0, 52_000.0], [520.0**2, 15 * 520.0**2])
        segments = find_edges(clean + rng.normal(0, np.sqrt(variance)), cell_px=1000.0)
        assert len(segments) == 1
        assert segments[0].clearance_px == np.inf


def faded(gap_px: float, turn_deg: float = 0.0, aside_px: float = 0.0) -> FloatArray:
    """A faint vertical edge through (80.3, y) that fades at row 180, beside one 17 times as strong.

    Below the gap it is turned about (80.3, 211) and moved aside.
    """
    y, x = np.mgrid[:240, :240].astype(np.float64)
    moved = np.where(y > 180.0, aside_px + np.tan(np.deg2rad(turn_deg)) * (y - 211.0), 0.0)
    contrast = point_edge(np.abs(y - 180.0) - gap_px / 2, 5.0)
    faint = 240.0 * contrast * (point_edge(x - 80.3 - moved, 0.8) - 0.5)
    return faint + 4000.0 * point_edge(x - 200.0, 0.8)


def test_an_edge_that_fades_for_a_stretch_is_one_edge() -> None:
    [faint] = [s for s in find_edges(faded(10.0), cell_px=1000.0) if s.x_px < 140.0]
    assert faint.length_px == pytest.approx(240.0, abs=1.0)
    assert faint.x_px == pytest.approx(80.3, abs=0.02)
    assert faint.y_px == pytest.approx(119.5, abs=0.5)


@pytest.mark.parametrize(
    ("gap_px", "turn_deg", "aside_px"),
    [
        pytest.param(35.0, 0.0, 0.0, id="a gap of more than a tenth of the edge"),
        pytest.param(10.0, 8.0, 0.0, id="another direction"),
        pytest.param(10.0, 1.0, 1.2, id="an end 1.7 px beside the line"),
        pytest.param(10.0, 0.0, 3.0, id="all of it beside the line"),
    ],
)
def test_pieces_that_do_not_continue_each_other_stay_apart(
    gap_px: float, turn_deg: float, aside_px: float
) -> None:
    found = find_edges(faded(gap_px, turn_deg, aside_px), cell_px=1000.0)
    upper, lower = (s for s in found if s.x_px < 140.0)
    assert upper.y_px < 180.0 < lower.y_px
    assert np.rad2deg(upper.normal_rad - lower.normal_rad) == pytest.approx(turn_deg, abs=0.3)


@pytest.mark.slow
def test_a_line_too_thin_for_the_fits_band_has_no_edges() -> None:
    # Its sides are 4 px apart: none has a level of its own beside it.
    x = np.tile(np.arange(110.0), (90, 1))
    line = 200.0 - 150.0 * point_edge(x - 52.0, 1.0) * point_edge(56.0 - x, 1.0)
    assert find_edges(line, cell_px=1000.0) == []


@pytest.mark.parametrize("sigma_px", [0.9, 1.6])
@pytest.mark.parametrize("turn_deg", [0.0, 12.0, 31.0])
def test_the_sides_of_a_chessboard_that_fills_the_picture_are_found(
    turn_deg: float, sigma_px: float
) -> None:
    side_px, size = 24.0, 160
    y, x = np.mgrid[:size, :size].astype(np.float64) - (size - 1) / 2
    t = np.deg2rad(turn_deg)
    board = np.ones((size, size))
    for along in (np.cos(t) * x + np.sin(t) * y, np.cos(t) * y - np.sin(t) * x):
        crossings = [(-1.0) ** k * point_edge(along - k * side_px, sigma_px) for k in range(-6, 7)]
        board *= 2.0 * np.sum(crossings, axis=0) - 1.0
    noise = np.random.default_rng(2).normal(0.0, 12.0, board.shape)
    segments = find_edges(1000.0 + 600.0 * board + noise)
    # Squares with all their sides in the middle 120 px: at least 4 x 4 of them, 40 sides.
    middle = [s for s in segments if max(abs(s.x_px - 79.5), abs(s.y_px - 79.5)) < 60.0]
    assert len(middle) >= 36


@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
def test_a_corner_2_px_from_the_border_is_no_end_at_the_border(sigma_px: float) -> None:
    y, x = np.mgrid[:90, :140].astype(np.float64)
    inside = point_edge(x - 25.0, sigma_px) * point_edge(115.0 - x, sigma_px)
    # Two px of dark ground lie between the lower and upper side and the outer pixels' rims.
    inside *= point_edge(y - 1.5, sigma_px) * point_edge(87.5 - y, sigma_px)
    segments = find_edges(200.0 + 600.0 * inside)
    assert len(segments) == 4
    for segment in segments:
        side_px = 90.0 if abs(np.sin(segment.normal_rad)) > 0.7 else 86.0
        # At 2 sigma from a corner, contrast is 2 % short.
        assert segment.length_px < side_px - 4.0 * sigma_px


def test_an_edge_that_leaves_the_frame_is_used_up_to_the_border() -> None:
    for normal_deg in (0.0, 10.0, 35.0, 80.0):
        image = edge_image(1.5, normal_deg, shape=(90, 90))
        [segment] = find_edges(image, cell_px=1000.0)
        longest_px = 90.0 / max(abs(np.cos(segment.normal_rad)), abs(np.sin(segment.normal_rad)))
        assert segment.length_px > longest_px - 3.0  # a pixel and a half at either end


def test_a_short_side_whose_ridge_turns_with_its_corners_is_found() -> None:
    # One of 900 such squares, three of whose sides alone were found.
    size = 81
    rng = np.random.default_rng(109)
    cover = square_cover((39.86, 39.83), 22.0, 60.7, 1.5, (size, size))
    segments = find_edges(40_000.0 - 32_000.0 * cover + rng.normal(0.0, 320.0, cover.shape))
    assert len(segments) == 4


SIGMA_PX = 0.8
CUT_PX = 5.0  # what corners cost at either end


def segment(first: FloatArray, last: FloatArray) -> EdgeSegment:
    """The edge between two corners (x, y), cut at both ends."""
    middle = (first + last) / 2
    dx, dy = last - first
    length = float(np.hypot(dx, dy))
    return EdgeSegment(
        x_px=float(middle[0]),
        y_px=float(middle[1]),
        normal_rad=float(np.arctan2(dy, dx)) - np.pi / 2,
        length_px=length - 2 * CUT_PX,
        found_length_px=length,
        sigma_px=SIGMA_PX,
    )


def projected(x: float, y: float, tilt: float, turn_deg: float) -> FloatArray:
    """A point of the plane, turned about its origin and tilted: as a camera sees it, in px."""
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    u, v = c * x - s * y, s * x + c * y
    return np.array([320.0 + u / (1.0 + tilt * u), 240.0 + v / (1.0 + tilt * u)])


def board(tilt: float = 0.0, turn_deg: float = 0.0, side_px: float = 40.0) -> list[EdgeSegment]:
    """All sides of the squares of a chessboard of 7 x 5 squares."""
    corners = {
        (k, j): projected((k - 3.5) * side_px, (j - 2.5) * side_px, tilt, turn_deg)
        for k in range(8)
        for j in range(6)
    }
    return [
        segment(corners[here], corners[there])
        for here in corners
        for there in ((here[0] + 1, here[1]), (here[0], here[1] + 1))
        if there in corners
    ]


def squares(
    centres: list[tuple[float, float]], side_px: float, turn_deg: float
) -> list[EdgeSegment]:
    """The sides of separate squares."""
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    edges = []
    for x, y in centres:
        ring = [
            np.array([x + side_px / 2 * (c * u - s * v), y + side_px / 2 * (s * u + c * v)])
            for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        edges += [segment(ring[k], ring[(k + 1) % 4]) for k in range(4)]
    return edges


def grid(pitch_px: float) -> list[tuple[float, float]]:
    return [(80 + pitch_px * k, 60 + pitch_px * j) for k in range(5) for j in range(4)]


def judged(edges: list[EdgeSegment], levels: list[tuple[float, float]]) -> BoolArray:
    return beside_target(edges, np.array(levels, dtype=np.float64).reshape(-1, 2))


def shelf(x: float, y: float, turn_deg: float, length_px: float = 60.0) -> EdgeSegment:
    along = length_px / 2 * np.array([np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))])
    return segment(np.array([x, y]) - along, np.array([x, y]) + along)


@settings(max_examples=40, deadline=None)
@given(
    tilt=st.floats(-1.5e-3, 1.5e-3),
    turn=st.floats(0.0, 90.0),
    dark=st.floats(5.0, 80.0),
    falloff=st.floats(0.0, 0.5),
)
def test_no_edge_of_a_tilted_board_in_uneven_light_is_taken_for_the_scene(
    tilt: float, turn: float, dark: float, falloff: float
) -> None:
    edges = board(tilt, turn)
    light = [1.0 - falloff * np.hypot(e.x_px - 320, e.y_px - 240) / 200 for e in edges]
    assert not judged(edges, [(dark * w, 230.0 * w) for w in light]).any()


@settings(max_examples=40, deadline=None)
@given(turn=st.floats(0.0, 90.0), away=st.floats(25.0, 65.0), bright=st.floats(60.0, 140.0))
def test_edges_of_other_levels_or_directions_beside_a_board_are_the_scenes(
    turn: float, away: float, bright: float
) -> None:
    target = board(turn_deg=turn)
    other_levels = [shelf(40.0, 60.0 + 80 * k, turn) for k in range(4)]
    other_direction = [shelf(610.0, 40.0 + 100 * k, turn + away) for k in range(4)]
    levels = [(30.0, 220.0)] * len(target) + [(30.0, bright)] * 4 + [(30.0, 220.0)] * 4
    beside = judged(target + other_levels + other_direction, levels)
    assert not beside[: len(target)].any()
    assert beside[len(target) :].all()


def test_the_order_of_the_edges_does_not_matter() -> None:
    edges = [*board(tilt=1e-3), *(shelf(40.0, 50.0 + 70 * k, 30.0) for k in range(5))]
    levels = [(30.0, 220.0)] * (len(edges) - 5) + [(50.0, 120.0)] * 5
    order = np.random.default_rng(1).permutation(len(edges))
    beside = judged([edges[k] for k in order], [levels[k] for k in order])
    np.testing.assert_array_equal(beside, judged(edges, levels)[order])
    assert beside.sum() == 5


def test_separate_squares_are_one_target_and_half_a_square_at_the_frame_is_part_of_it() -> None:
    chart = squares(grid(90.0), 40.0, 6.0)
    half_seen = shelf(80.0 + 5 * 90.0 - 20.0, 150.0, 96.0, 40.0)
    beside = judged([*chart, half_seen], [(30.0, 220.0)] * (len(chart) + 1))
    assert not beside.any()


def test_squares_of_another_contrast_in_the_charts_directions_are_the_targets() -> None:
    chart = squares(grid(90.0), 40.0, 6.0)
    faint = squares([(80.0 + 90.0 * 5, 60.0), (80.0 + 90.0 * 5, 150.0)], 40.0, 6.0)
    levels = [(30.0, 220.0)] * len(chart) + [(120.0, 200.0)] * len(faint)
    assert not judged(chart + faint, levels).any()


@pytest.mark.parametrize("count", [0, 1, 2, 11])
def test_few_edges_are_all_the_targets(count: int) -> None:
    edges = [shelf(50.0 * k + 50, 80.0, 17.0 * k) for k in range(count)]
    assert not judged(edges, [(10.0 * k, 100.0 + 20 * k) for k in range(count)]).any()


def test_edges_without_corners_are_all_the_targets() -> None:
    fan = [
        shelf(320 + 150 * np.cos(a), 240 + 150 * np.sin(a), np.rad2deg(a)) for a in np.arange(24)
    ]
    assert not judged(fan, [(20.0 + k, 200.0 - 3 * k) for k in range(24)]).any()


def test_of_two_patterns_of_one_size_neither_is_the_scene() -> None:
    left = squares(grid(70.0), 36.0, 5.0)
    right = squares([(x + 500.0, y) for x, y in grid(70.0)], 36.0, 40.0)
    third = squares([(x, y + 400.0) for x, y in grid(70.0)], 36.0, 20.0)
    levels = [(30.0, 220.0)] * 80 + [(100.0, 160.0)] * 80 + [(5.0, 60.0)] * 80
    assert not judged(left + right + third, levels).any()


def test_an_edge_far_wider_than_the_board_about_it_is_the_scenes() -> None:
    rng = np.random.default_rng(9)
    # Out of focus towards the right: 0.8 to 1.6 px, with 5 % of scatter.
    edges = [
        replace(edge, sigma_px=(0.8 + 0.8 * edge.x_px / 640.0) * rng.normal(1.0, 0.05))
        for edge in board()
    ]
    shadow = replace(segment(np.array([300.0, 230.0]), np.array([340.0, 236.0])), sigma_px=3.6)
    blurred = replace(edges[40], sigma_px=2.6 * edges[40].sigma_px)
    beside = judged([*edges[:40], blurred, *edges[41:], shadow], [(20.0, 230.0)] * (len(edges) + 1))
    assert np.flatnonzero(beside).tolist() == [40, len(edges)]
