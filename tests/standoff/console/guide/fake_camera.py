"""A film for Chromium's fake camera: an approach to where a reference was taken, then a rest."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.truth.hand_held import HeldPose, Wall

SIZE = (640, 480)
SCREEN: dict[str, Any] = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
    "ignore_https_errors": True,
}
REPEATED = 3
"""Chromium plays a film of JPEG pictures at 30 a second."""

_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 92]


def pose_at(share: float) -> HeldPose:
    """From 40 % too far, aside and turned (0) to the reference's own pose (1)."""
    left = 1 - min(max(share, 0.0), 1.0)
    turn = Rotation.from_euler("xyz", [4 * left, -5 * left, 12 * left], degrees=True)
    return HeldPose(centre=np.array([0.1, -0.06, -0.4]) * left, axes=turn.as_matrix())


def write_film(path: Path, wall: Wall, shares: list[float]) -> None:
    """Write a film (.mjpeg) with a tenth of a second at each place of the approach."""
    rng = np.random.default_rng(3)
    with path.open("wb") as film:
        for share in shares:
            levels = wall.seen([pose_at(share)], rng)
            film.write(REPEATED * cv2.imencode(".jpg", levels, _JPEG)[1].tobytes())


def camera_options(film: Path) -> tuple[str, ...]:
    """Options of Chromium: its camera plays a film, and pages may use it."""
    return (
        "--use-fake-ui-for-media-stream",
        "--use-fake-device-for-media-stream",
        f"--use-file-for-fake-video-capture={film}",
    )
