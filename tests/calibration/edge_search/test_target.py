from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import EdgeSegment
from calibration.edges.detection import beside_target
from simulation.arrays import BoolArray, FloatArray

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
