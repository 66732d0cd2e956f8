"""The tilt of the camera to a board, of frames that OpenCV's own board image makes."""

import cv2
import numpy as np
import pytest

from calibration.geometry import DEFAULT_BOARD
from standoff.console.devices import SquarenessMonitor
from standoff.console.devices.frame_broadcaster import FrameBroadcaster, LiveFrame
from tests.acquisition.fakes import SETTINGS

ROWS, COLS, FOCAL_PX = 580, 780, 960.0


def board_frame(tilt_right_deg: float) -> LiveFrame:
    """The board on a plane 300 mm away whose right side is further away."""
    layout = cv2.aruco.CharucoBoard(
        (DEFAULT_BOARD.columns, DEFAULT_BOARD.rows),
        DEFAULT_BOARD.square_mm,
        DEFAULT_BOARD.marker_mm,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DEFAULT_BOARD.dictionary}")),
    )
    px_per_mm = 16
    size_mm = np.array([DEFAULT_BOARD.columns, DEFAULT_BOARD.rows]) * DEFAULT_BOARD.square_mm
    flat = layout.generateImage(tuple(round(v * px_per_mm) for v in size_mm))
    away_mm = 0.75 * FOCAL_PX * size_mm[0] / COLS * 1.6
    tilt = np.deg2rad(tilt_right_deg)
    centre = size_mm / 2
    first = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    second = np.array([0.0, 1.0, 0.0])
    origin = np.array([0.0, 0.0, away_mm]) - centre[0] * first - centre[1] * second
    camera = np.array([[FOCAL_PX, 0, (COLS - 1) / 2], [0, FOCAL_PX, (ROWS - 1) / 2], [0, 0, 1]])
    matrix = (
        camera
        @ np.column_stack([first, second, origin])
        @ np.diag([1 / px_per_mm, 1 / px_per_mm, 1])
    )
    big = np.diag([4.0, 4.0, 1.0])
    big[0, 2] = big[1, 2] = 1.5  # centres of pixels at integers, four times as fine
    seen = cv2.warpPerspective(flat, big @ matrix, (4 * COLS, 4 * ROWS), borderValue=255)
    fine = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 2.4)
    image = fine.reshape(ROWS, 4, COLS, 4).mean(axis=(1, 3)) * 10 + 300
    noisy = np.random.default_rng(3).normal(image, 8)
    return LiveFrame(
        image_dn=np.rint(noisy).astype(np.uint16), sequence=1, received_s=1.0, settings=SETTINGS
    )


@pytest.mark.slow
@pytest.mark.parametrize("tilt_right_deg", [-2.0, 0.0, 0.7])
def test_the_tilt_to_a_board_is_shown_with_the_side_to_raise(tilt_right_deg: float) -> None:
    monitor = SquarenessMonitor(FrameBroadcaster(), DEFAULT_BOARD, FOCAL_PX)
    monitor.watch(True)
    monitor.look(board_frame(tilt_right_deg))
    found = monitor.view.levelling
    assert found is not None, monitor.view.why_not
    # Corners of an image are found to some hundredths of a pixel, with an error of some that a
    # board image of limited resolution adds.
    assert found.right_deg == pytest.approx(tilt_right_deg, abs=0.15)
    assert found.down_deg == pytest.approx(0, abs=0.15)
    side = {-1: "right", 1: "left"}.get(int(np.sign(tilt_right_deg)))
    assert (found.advice == "level") if side is None else (f"raise the {side} side" in found.advice)


def test_without_a_board_the_page_says_so_and_nothing_is_shown_once_it_is_off() -> None:
    monitor = SquarenessMonitor(FrameBroadcaster(), DEFAULT_BOARD, FOCAL_PX)
    monitor.watch(True)
    blank = LiveFrame(
        image_dn=np.full((ROWS, COLS), 900, np.uint16),
        sequence=1,
        received_s=1.0,
        settings=SETTINGS,
    )
    monitor.look(blank)
    assert "board" in monitor.view.why_not
    monitor.watch(False)
    monitor.look(blank)
    assert monitor.view.why_not == ""
