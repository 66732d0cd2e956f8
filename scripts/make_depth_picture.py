"""Make the pictures of docs/theory-depth.md: a rendered scene with depth, compared and simulated.

python -m scripts.make_depth_picture docs/images
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from analysis.changes import ChangeOptions, changes_between
from benchmarks.studies.depth_simulation import PSF, ground_homography
from benchmarks.truth.depth import DepthPair, DepthScene, View, depth_pair, depth_scene
from simulation import SceneDepth
from simulation.arrays import FloatImage
from simulation.pose import DepthRendering, DepthView

_TILT_DEG, _BEARING_DEG, _PARALLAX_PX, _BASELINE = 8.0, 30.0, 30.0, 0.14
_NOISE_DN, _SPOT_DN, _SPOT_SIGMA_PX = 1.0, 30.0, 3.0
_SPOTS = ((110.0, 60.0), (60.0, 90.0), (250.0, 120.0))
"""Rows and columns of what is painted on the follow-up."""

_REACH_DN = 25.0


def _bytes(share: FloatImage) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(np.nan_to_num(share, nan=1.0), 0, 1)).astype(np.uint8)


def _row(path: Path, shares: list[FloatImage]) -> None:
    """Write pictures of one height beside each other."""
    gap: NDArray[np.uint8] = np.full((shares[0].shape[0], 8), 255, dtype=np.uint8)
    drawn = [part for share in shares for part in (_bytes(share), gap)][:-1]
    cv2.imwrite(str(path), np.hstack(drawn), [cv2.IMWRITE_JPEG_QUALITY, 85])


def main(folder: Path) -> None:
    """Photograph a scene twice; compare the two, and simulate the second from the first."""
    scene = depth_scene("both", 3, _PARALLAX_PX, _BASELINE)
    near, far = View(), View(distance_px=1300.0, tilt_deg=_TILT_DEG, bearing_deg=_BEARING_DEG)
    made = depth_pair(scene, near, far)
    _row(folder / "depth-pair.jpg", _compared(made))
    _row(folder / "depth-simulated.jpg", _simulated(scene, made, near))


def _compared(made: DepthPair) -> list[FloatImage]:
    """Before, after with spots, what a plane leaves, what is left with depth, the parallax."""
    before, after = made.noisy(np.random.default_rng(1), _NOISE_DN)
    y, x = np.indices(after.shape)
    for row, col in _SPOTS:
        spot = np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * _SPOT_SIGMA_PX**2))
        after = after + np.float32(_SPOT_DN) * spot.astype(np.float32)
    plane = changes_between(before, after, options=ChangeOptions(flat=True))
    found = changes_between(before, after)
    if found.parallax is None:
        raise SystemExit("no depth was found")
    low, high = np.nanpercentile(found.parallax.parallax_px, [1, 99])
    return [
        before / 255,
        after / 255,
        *(
            np.where(one.valid, 0.5 + one.difference_dn / (2 * _REACH_DN), np.nan)
            for one in (plane, found)
        ),
        (found.parallax.parallax_px - low) / (high - low),
    ]


def _simulated(scene: DepthScene, made: DepthPair, near: View) -> list[FloatImage]:
    """The reference, its depth, the follow-up simulated and rendered, and the difference."""
    rows, cols = scene.frame
    y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
    heights = scene.points(near, x, y)[0][2]
    known = SceneDepth(
        depth=near.distance_px - heights,
        focal_length_px=near.focal_px,
        plane_depth=near.distance_px,
    )
    matrix = ground_homography(made)
    view = DepthView.of_homography(known, matrix, (cols, rows))
    found = DepthRendering.of(known, view, PSF).photograph(made.reference_dn)
    unseen = found.outside if found.hidden is None else found.outside | found.hidden
    off = np.where(unseen, np.nan, 0.5 + (found.image - made.followup_dn) / (2 * _REACH_DN))
    return [
        made.reference_dn / 255,
        (heights - heights.min()) / np.ptp(heights),
        np.where(unseen, np.nan, found.image / 255),
        made.followup_dn / 255,
        off,
    ]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
