import numpy as np
import pytest

from calibration.edges import EdgeImage, EdgeSelection, measure_edges
from calibration.edges.measurement import told_apart
from hil_mocks import BenchTruth
from tests.calibration.squares import chart
from tests.hil_mocks.benches import bench_config

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
    assert [repr(edge) for edge in edges] == [repr(edge) for edge in measure_edges(source)]
    assert not any("beside_target" in edge.flags for edge in edges)


@pytest.mark.parametrize("pitch_px", [1, 2])
def test_a_chart_alone_is_the_target_in_the_pixels_of_any_plane(pitch_px: int) -> None:
    image = WHITE_DN - (WHITE_DN - BLACK_DN) * chart(240, 288, turn_deg=5.0, shear=12.0)
    image += np.random.default_rng(4).normal(0.0, 200.0, image.shape)
    source = EdgeImage(name="chart", image_dn=image, pitch_px=pitch_px)
    edges = told_apart(measure_edges(source), pitch_px)
    assert len(edges) >= 100  # 30 squares
    assert not any("beside_target" in edge.flags for edge in edges)


@pytest.mark.parametrize("target", ["edge", "chart", "board"])
def test_no_good_edge_of_a_target_of_the_simulated_bench_is_thrown_away(target: str) -> None:
    bench = BenchTruth(bench_config(simulated__width_px=480, simulated__height_px=360))
    image = bench.expected_image_dn(target, 5.0, 150.0, exposure_us=4_000.0)
    image = image + np.random.default_rng(5).normal(0.0, 5.0, image.shape)
    edges = told_apart(measure_edges(EdgeImage(name=target, image_dn=image)))
    assert edges
    assert not any("beside_target" in edge.flags for edge in edges)
