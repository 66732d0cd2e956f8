"""Two photographs on one grid, aligned by a plane, and what they show between their pixels."""

from dataclasses import dataclass, replace
from math import ceil, sqrt
from typing import Self

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, Float32Array, FloatArray

_LIGHT_PX = 12.0
"""Width over which a photograph is compared with its own mean and contrast."""

_CONTRAST_FLOOR = 0.15
"""Of the contrast's root mean square over the frame: where there is none, noise is not made one."""

_MATCHED_ON_PX = 7e5
"""Pixels above which matching is done on an image that is reduced first."""

_SOFTER, _LEAST_SOFTER_PX = 0.5, 0.1
"""Smoothing of what is sampled z times as far apart, over the root of z^2 - 1, before it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AlignedViews:
    """A target and a source on one grid, aligned by a plane.

    ``target, source``: shape ``(rows, cols)``. ``is_target, is_source``: where they show anything.
    ``to_x, to_y``: unit vectors of the epipolar lines, towards the epipole.
    """

    target: Float32Array
    source: Float32Array
    is_target: BoolArray
    is_source: BoolArray
    to_x: Float32Array
    to_y: Float32Array

    @classmethod
    def of(cls, target: Float32Array, source: Float32Array, pose: DistortedPose) -> Self:
        """Bring the source to the target's pixels, at the target's sampling; no lines yet."""
        softer_px = _SOFTER * sqrt(max(pose.zoom**2 - 1, 0.0))
        if softer_px > _LEAST_SOFTER_PX:
            source = np.asarray(cv2.GaussianBlur(source, (0, 0), softer_px), dtype=np.float32)
        to_y, to_x = (at.astype(np.float32) for at in pose.followup_places_px())
        seen = seen_at(spline_of(source), to_y, to_x)
        is_source = np.isfinite(seen)
        is_target = np.isfinite(target)
        mean = np.float32(np.mean(seen[is_source]))
        return cls(
            target=np.where(is_target, target, np.float32(0)),
            source=np.where(is_source, seen, mean).astype(np.float32),
            is_target=is_target,
            is_source=is_source,
            to_x=np.zeros_like(target),
            to_y=np.zeros_like(target),
        )

    def along(self, to_x: FloatArray, to_y: FloatArray) -> Self:
        """Return the same with epipolar lines."""
        return replace(self, to_x=to_x.astype(np.float32), to_y=to_y.astype(np.float32))

    def in_own_light(self) -> Self:
        """Return the same in units of the contrast around."""
        return replace(
            self,
            target=in_own_light(self.target, self.is_target),
            source=in_own_light(self.source, self.is_source),
        )

    def reversed(self) -> Self:
        """Return the same from the source, from which the target lies the other way."""
        return replace(
            self,
            target=self.source,
            source=self.target,
            is_target=self.is_source,
            is_source=self.is_target,
            to_x=-self.to_x,
            to_y=-self.to_y,
        )

    def reduced(self, factor: int) -> Self:
        """Return the same with larger pixels; at the border what is over is left out."""
        if factor == 1:
            return self
        rows, cols = (n // factor for n in self.target.shape)
        part = np.s_[: rows * factor, : cols * factor]

        def smaller(image: Float32Array) -> Float32Array:
            return np.asarray(
                cv2.resize(image[part], (cols, rows), interpolation=cv2.INTER_AREA), np.float32
            )

        length = np.maximum(np.hypot(smaller(self.to_x), smaller(self.to_y)), np.float32(1e-9))
        return replace(
            self,
            target=smaller(self.target),
            source=smaller(self.source),
            is_target=smaller(self.is_target.astype(np.float32)) > 0.999,
            is_source=smaller(self.is_source.astype(np.float32)) > 0.999,
            to_x=np.asarray(smaller(self.to_x) / length, dtype=np.float32),
            to_y=np.asarray(smaller(self.to_y) / length, dtype=np.float32),
        )


def matching_factor(pixels: int) -> int:
    """By how much photographs of so many pixels are reduced, to be matched."""
    return max(ceil(sqrt(pixels / _MATCHED_ON_PX)), 1)


def in_own_light(image: Float32Array, shown: BoolArray) -> Float32Array:
    """A photograph less its local mean, over its local contrast; 0 where it shows nothing."""
    weight = _blurred(shown.astype(np.float32)) + np.float32(1e-6)
    known = np.where(shown, image, np.float32(0))
    mean = _blurred(known) / weight
    apart = np.where(shown, image - mean, np.float32(0))
    contrast = np.sqrt(_blurred(apart**2) / weight)
    floor = _CONTRAST_FLOOR * float(np.sqrt(np.mean(contrast[shown] ** 2))) if shown.any() else 1.0
    return np.asarray(apart / np.hypot(contrast, np.float32(max(floor, 1e-12))), dtype=np.float32)


def _blurred(image: Float32Array) -> Float32Array:
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), _LIGHT_PX, borderType=cv2.BORDER_REFLECT_101), np.float32
    )


def shifted_along(
    image: Float32Array, views: AlignedViews, parallax_px: Float32Array, interpolation: int
) -> Float32Array:
    """What an image shows where each pixel lies in it; NaN outside."""
    rows, cols = parallax_px.shape
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float32)
    return np.asarray(
        cv2.remap(
            image,
            x + parallax_px * views.to_x,
            y + parallax_px * views.to_y,
            interpolation,
            borderValue=(np.nan,) * 4,
        ),
        dtype=np.float32,
    )


def spline_of(image: Float32Array) -> Float32Array:
    """Coefficients of the cubic spline through an image.

    OpenCV's cubic kernel reproduces no straight line: it displaces by up to .044 px.
    """
    return np.asarray(spline_filter(image, order=3, output=np.float32), dtype=np.float32)


def seen_at(spline: Float32Array, y_px: Float32Array, x_px: Float32Array) -> Float32Array:
    """Levels of an image between its pixels, by its spline; NaN outside."""
    return np.asarray(
        map_coordinates(
            spline, [y_px, x_px], np.float32, order=3, mode="constant", cval=np.nan, prefilter=False
        ),
        dtype=np.float32,
    )
