"""What of a frame, beside its pose, costs changes: blur, too little light, glare, another scene."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray

ByteImage = NDArray[np.uint8]

LEAST_SHARPNESS: Final = 0.5
LEAST_AGREEMENT: Final = 0.5
_LEAST_AGREEMENT_BLURRED = 0.2
LEAST_LEVEL: Final = 0.1
MOST_GLARE: Final = 0.03

_FINE_PX, _COARSE_PX = 1.0, 5.0
"""Widths between which detail is compared: noise is finer, light and shadow are coarser."""
_CLIPPED = 250
_LEAST_COMMON = 0.2
"""Share of the frame that must show the reference; from less nothing is said."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFaults:
    """How a frame compares with the reference seen from the same pose.

    Parameters
    ----------
    sharpness
        Squared gradient of fine detail over that of the reference, each relative to its own coarse
        contrast: 1 if both are equally sharp.
    agreement
        Correlation of the detail of both: 1 for one scene, about 0 for two.
    level
        Mean level of the frame, from 0 to 1 as it is displayed.
    glare
        Share of the frame that is white and was not in the reference.
    """

    sharpness: float
    agreement: float
    level: float
    glare: float

    @property
    def is_same_scene(self) -> bool:
        """Whether the frame shows the reference's scene at the pose found; blur hides detail."""
        is_sharp = self.sharpness >= LEAST_SHARPNESS
        return self.agreement >= (LEAST_AGREEMENT if is_sharp else _LEAST_AGREEMENT_BLURRED)

    def costs(self) -> dict[str, float]:
        """Each fault as a multiple of what is accepted."""
        return {
            "sharpness": LEAST_SHARPNESS / max(self.sharpness, 1e-3),
            "light": LEAST_LEVEL / max(self.level, 1e-3),
            "glare": self.glare / MOST_GLARE,
        }


def frame_faults(frame: ByteImage, reference: ByteImage, matrix: FloatArray) -> FrameFaults | None:
    """Compare a frame with the reference at its pose; None where they share too little.

    Parameters
    ----------
    frame, reference
        Grey levels as displayed, 0 to 255, shape ``(rows, cols)`` each, of about one resolution.
    matrix
        Shape (3, 3): pixel centres ``(x, y, 1)`` of the frame to those of the reference.
    """
    rows, cols = frame.shape
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    view, inside = (
        np.asarray(cv2.warpPerspective(image, matrix, (cols, rows), flags=flags), np.uint8)
        for image in (reference, np.full(reference.shape, 255, np.uint8))
    )
    edge = round(3 * _COARSE_PX)
    common = cv2.erode(inside, np.ones((edge, edge), np.uint8), borderValue=0) == 255
    if np.count_nonzero(common) < _LEAST_COMMON * frame.size:
        return None
    detail, coarse = zip(*(_bands(image) for image in (frame, view)), strict=True)
    seen, was = (band[common] for band in detail)
    spread, was_spread = (float(band[common].std()) for band in coarse)
    energy, was_energy = (_squared_gradient(band, common) for band in detail)
    least = 1e-6
    return FrameFaults(
        sharpness=(energy / max(spread, least) ** 2)
        / max(was_energy / max(was_spread, least) ** 2, least),
        agreement=float(
            np.mean((seen - seen.mean()) * (was - was.mean()))
            / max(float(seen.std()) * float(was.std()), least)
        ),
        level=float(frame.mean()) / 255,
        glare=float(np.count_nonzero(common & (frame >= _CLIPPED) & (view < _CLIPPED)))
        / np.count_nonzero(common),
    )


def _bands(image: ByteImage) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Detail without noise and without light, and what is coarser."""
    levels = image.astype(np.float32)
    fine, coarse = (cv2.GaussianBlur(levels, (0, 0), width) for width in (_FINE_PX, _COARSE_PX))
    return np.asarray(fine - coarse, np.float32), np.asarray(coarse, np.float32)


def _squared_gradient(detail: NDArray[np.float32], common: NDArray[np.bool_]) -> float:
    slopes = (cv2.Sobel(detail, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    return float(sum(np.mean(np.square(np.asarray(slope)[common])) for slope in slopes))
