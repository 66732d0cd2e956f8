"""A photograph prepared for alignment: its usable pixels, and itself at several resolutions."""

from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.arrays import AnyArray, BoolArray, Float32Array

_PLATEAU_PX = 3
"""Side of a square of one extreme level that no scene with noise shows: clipped pixels."""

_LEAST_BETWEEN = 0.25
"""Share of a photograph that plateaus must leave: of a drawing in two levels, or a page scanned to
white, they are what it shows, and leave 2 to 7 %. A round field of view before black leaves half or
more."""

_PIXEL_VARIANCE_PX2 = 1 / 12


@dataclass(frozen=True, slots=True, eq=False)
class AlignedPhotograph:
    """Grey levels as float32 and the pixels that count, None where all do.

    Levels are divided by their standard deviation, so that no unit overflows. ``is_drawing`` where
    most of it lies at the ends of its levels, as in a drawing in two levels.
    """

    levels: Float32Array = field(repr=False)
    usable: BoolArray | None = field(repr=False)
    scale_dn: float
    is_drawing: bool = False
    _reduced: dict[int, Self] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, image: AnyArray, left_out: BoolArray | None = None) -> Self:
        """Take a grey image; clipped plateaus and what is ``left_out`` do not count.

        Plateaus do count where they are nearly all that there is.

        Raises
        ------
        ValueError
            If it is not a grey image with finite values, or ``left_out`` has another shape.
        """
        values = np.asarray(image, dtype=np.float32)
        if values.ndim != 2 or values.size == 0 or not np.isfinite(values).all():
            raise ValueError(
                f"alignment needs grey images with finite values, got shape {image.shape}"
            )
        if left_out is not None and left_out.shape != values.shape:
            raise ValueError(
                f"the mask has the shape {left_out.shape}, the photograph {values.shape}"
            )
        unusable = _clipped(values)
        is_drawing = np.count_nonzero(unusable) > (1 - _LEAST_BETWEEN) * unusable.size
        if is_drawing:
            unusable[:] = False
        if left_out is not None:
            unusable |= left_out
        usable = ~unusable if unusable.any() else None
        counted = values if usable is None else values[usable]
        middle = (
            float(np.median(counted[:: max(counted.size // 100_000, 1)])) if len(counted) else 0.0
        )
        scale = _spread(values, usable) if counted.size else 0.0
        levels = values - np.float32(middle)
        levels /= np.float32(scale or 1.0)
        if usable is not None:
            levels[~usable] = 0.0
        return cls(levels, usable, scale, is_drawing=bool(is_drawing))

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)``."""
        return self.levels.shape[0], self.levels.shape[1]

    def mirrored(self) -> Self:
        """Return the photograph with its columns reversed."""
        usable = None if self.usable is None else np.ascontiguousarray(self.usable[:, ::-1])
        return self._with(np.ascontiguousarray(self.levels[:, ::-1]), usable)

    def where(self, counted: BoolArray) -> Self:
        """Return the photograph of which only these pixels count, shape ``(rows, cols)``."""
        usable = counted if self.usable is None else counted & self.usable
        return self._with(self.levels, usable)

    def reduced(self, factor: int) -> Self:
        """Return the means of whole blocks of ``factor`` x ``factor`` pixels."""
        if factor == 1:
            return self
        # Every hypothesis and every resolution asks for them again.
        if factor not in self._reduced:
            self._reduced[factor] = self._shrunk_by(factor)
        return self._reduced[factor]

    def _shrunk_by(self, factor: int) -> Self:
        rows, cols = (n // factor for n in self.shape)
        part = np.s_[: rows * factor, : cols * factor]
        levels = _shrunk(self.levels[part], rows, cols)
        if self.usable is None:
            return self._with(levels, None)
        share = _shrunk(self.usable[part].astype(np.float32), rows, cols)
        return self._with(_ratio(levels, share), share > 0.99)

    def _with(self, levels: Float32Array, usable: BoolArray | None) -> Self:
        return type(self)(levels, usable, self.scale_dn, is_drawing=self.is_drawing)

    def smoothed(self, sigma_x_px: float, sigma_y_px: float) -> Self:
        """Return it after a Gaussian blur; what mixes with unusable pixels becomes unusable."""
        blur = (0, 0), max(sigma_x_px, 1e-3), max(sigma_y_px, 1e-3)
        levels = _blurred(self.levels, *blur)
        if self.usable is None:
            return self._with(levels, None)
        share = _blurred(self.usable.astype(np.float32), *blur)
        return self._with(_ratio(levels, share), share > 0.98)


def _spread(values: Float32Array, usable: BoolArray | None) -> float:
    mask = None if usable is None else usable.view(np.uint8)
    return float(cv2.meanStdDev(values, mask=mask)[1][0, 0])


def _clipped(values: Float32Array) -> BoolArray:
    """Pixels of plateaus at the highest or the lowest level, and their neighbours."""
    clipped = np.zeros(values.shape, dtype=np.bool_)
    square = np.ones((_PLATEAU_PX, _PLATEAU_PX), dtype=np.uint8)
    around = np.ones((_PLATEAU_PX + 2, _PLATEAU_PX + 2), dtype=np.uint8)
    for level in (values.max(), values.min()):
        plateau = cv2.erode((values == level).astype(np.uint8), square)
        if plateau.any():
            clipped |= cv2.dilate(plateau, around).astype(np.bool_)
    return clipped


def _shrunk(values: Float32Array, rows: int, cols: int) -> Float32Array:
    made = cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(made, dtype=np.float32)


def _blurred(
    values: NDArray[np.float32], size: tuple[int, int], sigma_x_px: float, sigma_y_px: float
) -> Float32Array:
    made = cv2.GaussianBlur(
        values, size, sigma_x_px, sigmaY=sigma_y_px, borderType=cv2.BORDER_REFLECT
    )
    return np.asarray(made, dtype=np.float32)


def _ratio(levels: Float32Array, share: Float32Array) -> Float32Array:
    return np.asarray(levels / np.maximum(share, np.float32(1e-3)), dtype=np.float32)


def blur_variance_px2(sigma_px: float, factor: int) -> float:
    """Variance of the blur of a photograph reduced by a factor, in its own pixels."""
    return (sigma_px**2 + (factor**2 - 1) * _PIXEL_VARIANCE_PX2) / factor**2
