"""The reference of a pose as a picture over the live one: its grey levels, or its edges."""

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.arrays import AnyArray, FloatArray
from standoff.console.frames import levels_8bit

OverlayView = Literal["photo", "edges"]

EDGE_COLOUR_BGR = (255, 60, 255)
"""Magenta: neither a grey of the picture, nor red as saturated pixels are, nor a mark's colour."""

SMOOTHING_PX = 1.5
"""Width of the blur before edges are looked for."""

BORDER_PX = 4
"""So near the border of the image no edges are looked for."""

NOISE_GRADIENTS = 7.0
"""A gradient of so many times its noise begins an edge, which half of that continues: on even
paper of 4 Mpx with white noise less than one pixel is drawn."""

QUANTISATION_DN = 12**-0.5
"""Standard deviation of what rounding to whole levels takes away."""

STRONG_FRACTION = 0.25
"""Of a scene's strong gradients: what is weaker is texture, and would hide the live picture."""

STRONG_PERCENT = 99.5
PX_PER_THICKNESS = 900
"""Columns for each pixel of an edge's thickness: a large picture is shown small."""

_DIAGONAL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float64)
"""J. Immerkaer, "Fast noise variance estimation", 1996: noise passes, edges and slopes hardly."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReferencePicture:
    """An image that poses are compared with.

    ``number`` is never given twice, also not by another start of the console. ``image_dn`` has the
    shape ``(rows, cols)``; a level of ``max_level_dn`` is saturated.
    """

    number: int
    name: str
    image_dn: AnyArray
    max_level_dn: float
    _lock: Lock = field(default_factory=Lock, repr=False)
    _made: dict[OverlayView, bytes] = field(default_factory=dict, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.image_dn.shape
        return int(rows), int(cols)

    def png(self, view: OverlayView) -> bytes:
        """A PNG file of it, made once: the levels as of the live picture, or the edges alone."""
        with self._lock:
            if view not in self._made:
                make = _photo if view == "photo" else _edges
                self._made[view] = cv2.imencode(".png", make(self))[1].tobytes()
            return self._made[view]


def reference_numbers() -> Iterator[int]:
    """Ascending numbers, above those of every earlier start."""
    return itertools.count(int(1e3 * time.time()))


def edge_mask(image_dn: AnyArray) -> NDArray[np.bool_]:
    """Where the edges of an image of shape ``(rows, cols)`` are, one pixel wide (Canny 1986).

    An edge stands out of the image's own noise and is not much weaker than its strongest ones.
    """
    levels = np.nan_to_num(np.asarray(image_dn, dtype=np.float64))
    right, down = _gradients(levels)
    strengths = np.hypot(right, down)
    most = float(strengths.max(initial=0.0))
    if most == 0.0:
        return np.zeros(levels.shape, dtype=np.bool_)
    strong = float(np.percentile(strengths, STRONG_PERCENT))
    rounding_dn = QUANTISATION_DN if image_dn.dtype.kind in "ui" else 0.0
    noise_dn = float(np.hypot(_noise(levels), rounding_dn))
    least = max(NOISE_GRADIENTS * noise_dn * _noise_gain(), STRONG_FRACTION * strong)
    if least > most:
        return np.zeros(levels.shape, dtype=np.bool_)
    scale = 32767.0 / most  # Canny takes gradients of 16 bits
    found = cv2.Canny(
        np.rint(scale * right).astype(np.int16),
        np.rint(scale * down).astype(np.int16),
        0.5 * scale * least,
        scale * least,
        L2gradient=True,
    )
    return np.asarray(found > 0)


def _gradients(levels: FloatArray) -> tuple[FloatArray, FloatArray]:
    smooth = cv2.GaussianBlur(levels, (0, 0), SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE)
    right = cv2.Sobel(smooth, cv2.CV_64F, 1, 0, ksize=3, borderType=cv2.BORDER_REPLICATE)
    down = cv2.Sobel(smooth, cv2.CV_64F, 0, 1, ksize=3, borderType=cv2.BORDER_REPLICATE)
    for gradient in (right, down):  # beyond the border nothing is known, and noise is larger
        gradient[:BORDER_PX] = gradient[-BORDER_PX:] = 0.0
        gradient[:, :BORDER_PX] = gradient[:, -BORDER_PX:] = 0.0
    return np.asarray(right, dtype=np.float64), np.asarray(down, dtype=np.float64)


def _noise(levels: FloatArray) -> float:
    """Standard deviation of white noise in an image, in its unit."""
    passed = cv2.filter2D(levels, cv2.CV_64F, _DIAGONAL, borderType=cv2.BORDER_REFLECT_101)
    return float(np.median(np.abs(passed)) / 0.6745 / np.sqrt(np.sum(_DIAGONAL**2)))


@cache
def _noise_gain() -> float:
    """Standard deviation of a gradient, of white noise with that of 1."""
    impulse = np.zeros((31, 31))
    impulse[15, 15] = 1.0
    return float(np.sqrt(np.sum(_gradients(impulse)[0] ** 2)))


def _photo(reference: ReferencePicture) -> NDArray[np.uint8]:
    levels = np.nan_to_num(np.asarray(reference.image_dn, dtype=np.float32))
    shown: NDArray[np.uint8] = levels_8bit(levels, reference.max_level_dn)  # type: ignore[arg-type]  # OpenCV scales these, too
    return shown


def _edges(reference: ReferencePicture) -> NDArray[np.uint8]:
    mask = edge_mask(reference.image_dn).astype(np.uint8)
    rows, cols = mask.shape
    thickness = 1 + 2 * (cols // (2 * PX_PER_THICKNESS))
    if thickness > 1:
        mask = np.asarray(cv2.dilate(mask, np.ones((thickness, thickness), np.uint8)), np.uint8)
    shown = np.zeros((rows, cols, 4), dtype=np.uint8)
    shown[mask > 0] = (*EDGE_COLOUR_BGR, 255)
    return shown
