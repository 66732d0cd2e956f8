from math import atan, degrees
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.bench import load_bench
from acquisition.errors import BenchConfigError
from hil_mocks import CameraPose, SimulatedBench
from hil_mocks.truth.targets import BOARD_COLS, BOARD_ROWS, BOARD_SQUARE_MM
from tests.hil_mocks.benches import bench_config, homed_bench

CONFIGS = Path(__file__).parents[2] / "configs"


def mean_of_frames(bench: SimulatedBench, count: int) -> NDArray[np.float64]:
    bench.camera.start()
    frames = [bench.camera.next_frame(1.0).image_dn.astype(np.float64) for _ in range(count)]
    bench.camera.stop()
    return np.asarray(np.mean(frames, axis=0))


def test_a_bench_without_truth_is_refused() -> None:
    config = bench_config().model_copy(update={"simulated": None})
    with pytest.raises(BenchConfigError) as refused:
        SimulatedBench(config)
    assert refused.value.keys == ("simulated",)


def test_a_lens_that_cannot_be_is_refused() -> None:
    with pytest.raises(BenchConfigError) as refused:
        SimulatedBench(bench_config(simulated__k1=-0.3))
    assert "k1" in str(refused.value)


def test_the_shipped_simulated_bench_opens() -> None:
    bench = SimulatedBench(load_bench(CONFIGS / "simulated.toml"))
    assert bench.camera.settings.width_px == 780
    assert bench.camera.settings.height_px == 580


def test_an_unknown_target_leaves_the_old_one() -> None:
    bench = homed_bench()
    bench.place("flat")
    with pytest.raises(ValueError):
        bench.place("flatt")
    assert bench.target == "flat"


def test_frames_scatter_about_the_expected_image() -> None:
    bench = homed_bench()
    bench.place("edge", 20.0)
    mean_dn = mean_of_frames(bench, 16)
    expected_dn = bench.truth.expected_image_dn("edge", 20.0, 200.0, exposure_us=8000.0)
    sigma_dn = np.sqrt([bench.truth.sensor.variance_dn2(dn, 0.0) for dn in expected_dn.ravel()])
    score = (mean_dn - expected_dn).ravel() / (sigma_dn / 4)
    # 6144 px: mean 0 +- 0.013, standard deviation 1 +- 0.009.
    assert abs(score.mean()) < 0.06
    assert score.std() == pytest.approx(1.0, abs=0.045)


def test_the_edge_of_a_placed_target_has_the_asked_direction() -> None:
    bench = homed_bench()
    bench.place("edge", 30.0)
    image_dn = mean_of_frames(bench, 4)
    low_dn, high_dn = image_dn[:3, -3:].mean(), image_dn[-3:, :3].mean()
    # A column's sum says where the edge crosses it: white is below.
    crossing_px = image_dn.shape[0] - ((image_dn - low_dn) / (high_dn - low_dn)).sum(axis=0)
    slope, crossing_at_0 = np.polyfit(np.arange(crossing_px.size), crossing_px, 1)
    assert degrees(atan(slope)) == pytest.approx(30.0, abs=0.1)
    assert slope * 47.5 + crossing_at_0 == pytest.approx(32.0, abs=0.1)  # row 31.5 ends at 32


def test_the_camera_follows_the_true_height_of_the_stage() -> None:
    bench = homed_bench(simulated__pupil_offset_mm=12.0)
    bench.place("coins")
    assert bench.pose == CameraPose(height_mm=200.0)
    near_dn = mean_of_frames(bench, 1)
    bench.stage.move_to(300.0, 60)
    far_dn = mean_of_frames(bench, 1)
    expected_dn = bench.truth.expected_image_dn("coins", 0.0, 300.0, exposure_us=8000.0)
    assert np.corrcoef(far_dn.ravel(), expected_dn.ravel())[0, 1] > 0.98
    assert np.corrcoef(far_dn.ravel(), near_dn.ravel())[0, 1] < 0.8


def test_another_mounting_shows_another_part_of_the_target() -> None:
    bench = homed_bench()
    bench.place("edge", 90.0)
    bench.mount(offset_x_mm=20.0)
    moved_dn = mean_of_frames(bench, 1)
    assert bench.pose == CameraPose(height_mm=200.0, offset_x_mm=20.0)
    # Moved along the edge's normal, the frame is 20 mm wide: one level all over.
    assert moved_dn.std() < 60


def test_the_frames_of_a_capture_cost_one_rendering() -> None:
    bench = homed_bench()
    pose = CameraPose(height_mm=200.0)
    first = bench.truth.irradiance("edge", 0.0, pose)
    assert bench.truth.irradiance("edge", 0.0, pose) is first
    assert not first.flags.writeable


def test_under_the_lens_cap_there_is_black_level_and_read_noise() -> None:
    bench = homed_bench(simulated__gloss=0.5)
    bench.place("dark")
    bench.camera.start()
    frames = np.stack([bench.camera.next_frame(1.0).image_dn for _ in range(10)]).astype(float)
    assert frames.mean() == pytest.approx(64.0, abs=0.05)  # 61 440 px of 2.4 DN
    assert frames.std() == pytest.approx(np.sqrt(2.4**2 + 1 / 12), rel=0.015)


def test_vignetting_darkens_the_corner_by_its_fraction() -> None:
    bench = homed_bench(simulated__vignetting=0.3)
    light = bench.truth.irradiance("flat", 0.0, CameraPose(height_mm=200.0))
    assert light[0, 0] == pytest.approx(0.7, rel=1e-5)
    assert light[31:33, 47:49].mean() == pytest.approx(1.0, abs=1e-3)


def test_a_highlight_moves_on_the_target_with_the_height() -> None:
    bench = homed_bench(simulated__gloss=0.5, simulated__width_px=780, simulated__height_px=580)
    places_mm = []
    for height_mm in (150.0, 250.0):
        pose = CameraPose(height_mm=height_mm)
        glare = bench.truth.irradiance("flat", 0.0, pose) - 1.0
        row, col = np.unravel_index(int(glare.argmax()), glare.shape)
        assert glare.max() == pytest.approx(0.5, abs=1e-3)
        x_mm, y_mm = bench.truth.camera.to_plane_mm(np.array([col]), np.array([row]), pose)
        places_mm.append((x_mm[0], y_mm[0]))
    # The mirror image of a lamp at (130, -70, 450) mm: 130 * 150 / 600 = 32.5 mm and so on.
    np.testing.assert_allclose(places_mm, [(32.5, -17.5), (46.43, -25.0)], atol=0.2)


@pytest.mark.slow
def test_opencv_finds_the_boards_corners_where_they_are() -> None:
    bench = SimulatedBench(load_bench(CONFIGS / "simulated.toml"))
    pose = CameraPose(height_mm=230.0, roll_deg=7.0, tilt_x_deg=2.0)
    picture_dn = bench.truth.expected_image_dn("board", 0.0, pose, exposure_us=9000.0)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard(
        (BOARD_COLS, BOARD_ROWS), BOARD_SQUARE_MM, 0.75 * BOARD_SQUARE_MM, dictionary
    )
    found, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(
        (picture_dn / 16).astype(np.uint8)
    )
    assert found is not None
    assert len(found) == (BOARD_COLS - 1) * (BOARD_ROWS - 1)
    points_mm = np.asarray(board.getChessboardCorners())[np.ravel(ids), :2]
    points_mm -= np.array([BOARD_COLS, BOARD_ROWS]) * BOARD_SQUARE_MM / 2
    true_px = np.column_stack(bench.truth.camera.to_pixel(points_mm[:, 0], points_mm[:, 1], pose))
    error_px = np.asarray(found).reshape(-1, 2) - true_px
    # OpenCV's corner refinement on 8 bit.
    assert np.hypot(*error_px.T).max() < 0.15
