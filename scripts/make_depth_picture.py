"""Make the picture of docs/theory-depth.md: a rendered scene with depth and its comparisons.

python -m scripts.make_depth_picture docs/images/depth-pair.jpg
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from analysis.changes import ChangeOptions, changes_between
from benchmarks.truth.depth import View, depth_pair, depth_scene
from simulation.arrays import FloatImage

_TILT_DEG, _BEARING_DEG, _PARALLAX_PX, _BASELINE = 8.0, 30.0, 30.0, 0.14
_NOISE_DN, _SPOT_DN, _SPOT_SIGMA_PX = 1.0, 30.0, 3.0
_SPOTS = ((110.0, 60.0), (60.0, 90.0), (250.0, 120.0))
"""Rows and columns of what is painted on the follow-up."""

_REACH_DN = 25.0


def _bytes(share: FloatImage) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(np.nan_to_num(share, nan=1.0), 0, 1)).astype(np.uint8)


def main(path: Path) -> None:
    """Photograph a scene twice, paint spots on it, compare it as a plane and with depth."""
    made = depth_pair(
        depth_scene("both", 3, _PARALLAX_PX, _BASELINE),
        View(),
        View(distance_px=1300.0, tilt_deg=_TILT_DEG, bearing_deg=_BEARING_DEG),
    )
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
    shares: list[FloatImage] = [
        before / 255,
        after / 255,
        *(
            np.where(one.valid, 0.5 + one.difference_dn / (2 * _REACH_DN), np.nan)
            for one in (plane, found)
        ),
        (found.parallax.parallax_px - low) / (high - low),
    ]
    gap: NDArray[np.uint8] = np.full((after.shape[0], 8), 255, dtype=np.uint8)
    drawn: list[NDArray[np.uint8]] = [part for share in shares for part in (_bytes(share), gap)][
        :-1
    ]
    cv2.imwrite(str(path), np.hstack(drawn), [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
