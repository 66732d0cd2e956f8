"""The reference as the guide uses it: upright, as displayed, and small enough to be followed."""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.photographs import (
    Photograph,
    linear_to_srgb,
    on_screen,
    read_photograph,
    white_level_dn,
)
from acquisition.printable import on_one_line
from calibration.errors import CalibrationError
from calibration.registration import TrackingReference
from simulation.arrays import AnyArray, FloatArray

ByteImage = NDArray[np.uint8]

FRAME_PX = 640
"""Longer side at which frames, stills and the reference are compared for their pose."""

_SHOWN_PX = 1280
_BRIGHTEST_PERCENT = 99.9


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GuideReference:
    """A reference, the way up it is viewed.

    Parameters
    ----------
    path
        Its file.
    name
        By which it is asked for, on one line; the stills of others have another.
    levels
        Grey levels as displayed, at most 640 px a side.
    size
        ``(width, height)`` in px of the file, turned as it is viewed.
    jpeg
        The picture for the page.
    """

    path: Path
    name: str
    levels: ByteImage = field(repr=False)
    size: tuple[int, int]
    jpeg: bytes = field(repr=False)

    @classmethod
    def read(cls, path: Path, name: str | None = None) -> "GuideReference":
        """Read a photograph, by default named as its file; refuse one that cannot be followed."""
        read = read_photograph(path)
        read.refuse_mosaic()
        view = UprightView.of(read)
        try:
            TrackingReference(view.levels)
        except CalibrationError as error:
            raise CalibrationError(f"{read.name}: {error}") from error
        picture = read.colour_planes if read.is_colour else read.grey_dn
        shown = upright(_smaller(picture, _SHOWN_PX), read.facts.orientation)
        data = np.rint(255 * np.clip(on_screen(shown, white_level_dn(shown)), 0, 1))
        drawn = data.astype(np.uint8)
        if drawn.ndim == 3:
            drawn = np.ascontiguousarray(drawn[..., ::-1])  # OpenCV's order
        jpeg = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
        known = on_one_line(path.name if name is None else name)
        return cls(path=path, name=known, levels=view.levels, size=view.size, jpeg=jpeg)

    @property
    def small_size(self) -> tuple[int, int]:
        """``(width, height)`` of ``levels``."""
        rows, cols = self.levels.shape
        return cols, rows


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class UprightView:
    """A photograph the way up it is viewed: small grey levels as displayed, and its full size.

    ``levels`` are brightened, so that a dark one can be compared; ``level`` is their mean before
    that, from 0 to 1.
    """

    levels: ByteImage
    level: float
    size: tuple[int, int]

    @classmethod
    def of(cls, photograph: Photograph) -> "UprightView":
        """Turn a photograph as its file says, and reduce it."""
        grey = np.asarray(photograph.grey_dn, dtype=np.float64)
        turned = upright(_smaller(grey, FRAME_PX), photograph.facts.orientation)
        small = np.asarray(turned, dtype=np.float64)
        white = max(float(np.percentile(small, _BRIGHTEST_PERCENT)), 1e-9)
        shown = linear_to_srgb(np.clip(small / white, 0.0, 1.0))
        rows, cols = grey.shape
        is_turned = (photograph.facts.orientation or 1) >= 5
        return cls(
            levels=np.rint(255 * np.asarray(shown)).astype(np.uint8),
            level=float(on_screen(small, photograph.white_dn).mean()),
            size=(rows, cols) if is_turned else (cols, rows),
        )


def upright(image: AnyArray, orientation: int | None) -> AnyArray:
    """Turn stored pixels as viewers do by Exif's orientation, 1 to 8."""
    turned = image.swapaxes(0, 1) if (orientation or 1) >= 5 else image
    flips = {2: (1,), 3: (0, 1), 4: (0,), 6: (1,), 7: (0, 1), 8: (0,)}.get(orientation or 1, ())
    return np.ascontiguousarray(np.flip(turned, flips) if flips else turned)


def scaled_matrix(
    matrix: FloatArray,
    sizes: tuple[tuple[int, int], tuple[int, int]],
    full_sizes: tuple[tuple[int, int], tuple[int, int]],
) -> FloatArray:
    """Carry a homography between reduced pictures over to the full ones.

    ``sizes, full_sizes``: ``(width, height)`` of the frame and of the reference.
    """
    frame, reference = (_scale(size, full) for size, full in zip(sizes, full_sizes, strict=True))
    found = reference @ matrix @ np.linalg.inv(frame)
    return np.asarray(found / found[2, 2], dtype=np.float64)


def _scale(size: tuple[int, int], full: tuple[int, int]) -> FloatArray:
    """Pixel centres of a reduced picture to those of the full one."""
    x, y = full[0] / size[0], full[1] / size[1]
    return np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])


def _smaller(image: AnyArray, most_px: int) -> AnyArray:
    rows, cols = image.shape[:2]
    factor = max(rows, cols) / most_px
    if factor <= 1:
        return image
    size = (max(round(cols / factor), 1), max(round(rows / factor), 1))
    return np.asarray(
        cv2.resize(np.asarray(image, dtype=np.float32), size, interpolation=cv2.INTER_AREA)
    )
