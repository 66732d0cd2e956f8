"""From the levels of a file to light and back: linear, sRGB, a power, or the curve of a profile.

The white of the file keeps its level: of 8 bits, 255 stays 255. What lies above white (float files
alone can hold it) continues the slope at white, and what lies below black is mirrored.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import cv2
import numpy as np

from analysis.screen import linear_to_srgb
from simulation.arrays import AnyArray, FloatArray

_GAMMA = re.compile(r"gamma:([0-9]+(?:\.[0-9]+)?)")
_LEAST_GAMMA, _LARGEST_GAMMA = 0.2, 10.0
_Curve: TypeAlias = Callable[[FloatArray], FloatArray]
_TABLE_BITS = 16  # integers up to this width are decoded by a table
_OPENCV_TABLE_BITS = 8  # OpenCV's look-up takes a quarter of NumPy's time
_STEP = 1e-3  # below white, for the slope there
_LEAST_SLOPE = 1e-3  # a curve that is flat at white is left by its inverse too


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoding:
    """The curve from encoded to linear levels, both from 0 to 1.

    ``name`` is ``linear``, ``srgb``, ``gamma:G`` or, for a colour profile whose curve is none of
    these, ``icc``; then ``curves`` holds linear levels at evenly spaced encoded ones, one curve for
    all channels or one for each.
    """

    name: str
    curves: tuple[FloatArray, ...] = field(default=(), repr=False, compare=False)

    def __post_init__(self) -> None:
        is_known = self.name in ("linear", "srgb") or self.gamma is not None
        if not is_known and (self.name != "icc" or not self.curves):
            raise ValueError(
                f"{self.name!r} is no encoding: expected linear, srgb or gamma:G, "
                f"G from {_LEAST_GAMMA:g} to {_LARGEST_GAMMA:g}, such as gamma:2.2"
            )

    @property
    def gamma(self) -> float | None:
        """Exponent of a power law; None for any other curve."""
        found = _GAMMA.fullmatch(self.name)
        if found is None or not _LEAST_GAMMA <= float(found[1]) <= _LARGEST_GAMMA:
            return None
        return float(found[1])

    @property
    def is_linear(self) -> bool:
        """Whether levels are proportional to light as they stand."""
        return self.name == "linear"

    def decode(self, levels: AnyArray, white_dn: float) -> FloatArray:
        """Return levels that are proportional to light, with the same white.

        Parameters
        ----------
        levels
            Shape ``(rows, cols)`` or ``(rows, cols, channels)``, as stored in the file.
        white_dn
            Level of white, positive.

        Raises
        ------
        ValueError
            If the curves are neither one nor one for each channel.
        """
        return self._mapped(levels, white_dn, [_decoded(curve) for curve in self._decoders()])

    def encode(self, levels: AnyArray, white_dn: float) -> FloatArray:
        """Return the levels that a file of this encoding stores; the inverse of ``decode``."""
        curves = zip(self._decoders(), self._encoders(), strict=True)
        return self._mapped(levels, white_dn, [_encoded(*pair) for pair in curves])

    def _decoders(self) -> list[_Curve]:
        if self.name == "srgb":
            return [srgb_to_linear]
        gamma = self.gamma
        if gamma is not None:
            return [lambda encoded: np.asarray(encoded**gamma)]
        return [_interpolation(np.linspace(0.0, 1.0, len(curve)), curve) for curve in self.curves]

    def _encoders(self) -> list[_Curve]:
        if self.name == "srgb":
            return [linear_to_srgb]
        gamma = self.gamma
        if gamma is not None:
            return [lambda linear: np.asarray(linear ** (1.0 / gamma))]
        return [_interpolation(curve, np.linspace(0.0, 1.0, len(curve))) for curve in self.curves]

    def _mapped(self, levels: AnyArray, white_dn: float, curves: list[_Curve]) -> FloatArray:
        if self.is_linear:
            return np.asarray(levels, dtype=np.float64)
        if len(curves) == 1:
            return _converted(levels, white_dn, curves[0])
        channels = levels.shape[2] if levels.ndim == 3 else 1
        if channels != len(curves):
            raise ValueError(f"{len(curves)} curves for {channels} channels")
        planes = [_converted(levels[:, :, i], white_dn, curve) for i, curve in enumerate(curves)]
        return np.stack(planes, axis=2)


LINEAR = Encoding(name="linear")
SRGB = Encoding(name="srgb")


def srgb_to_linear(encoded: FloatArray) -> FloatArray:
    """IEC 61966-2-1:1999, section 5.2, from 0 to 1."""
    power = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, power)


def _interpolation(at: FloatArray, values: FloatArray) -> _Curve:
    return lambda wanted: np.interp(wanted, at, values)


def _converted(levels: AnyArray, white_dn: float, curve: _Curve) -> FloatArray:
    bits = 8 * levels.dtype.itemsize
    if levels.dtype.kind == "u" and bits <= _TABLE_BITS and levels.size > 2**bits:
        every = np.arange(2**bits, dtype=np.float64)
        table = curve(every / white_dn) * white_dn
        if bits <= _OPENCV_TABLE_BITS:
            return np.asarray(cv2.LUT(np.ascontiguousarray(levels), table))
        return np.asarray(table[levels])
    return curve(np.asarray(levels, dtype=np.float64) / white_dn) * white_dn


def _decoded(curve: _Curve) -> _Curve:
    return lambda values: _extended(values, curve, _slope_at_white(curve))


def _encoded(decoder: _Curve, encoder: _Curve) -> _Curve:
    return lambda values: _extended(values, encoder, 1.0 / _slope_at_white(decoder))


def _slope_at_white(decoder: _Curve) -> float:
    slope = float(1.0 - decoder(np.array([1.0 - _STEP]))[0]) / _STEP
    return max(slope, _LEAST_SLOPE)


def _extended(values: FloatArray, curve: _Curve, slope: float) -> FloatArray:
    """The curve from 0 to 1, mirrored below 0 and straight above 1."""
    size = np.abs(values)
    inside = curve(np.minimum(size, 1.0))
    return np.copysign(inside + slope * np.maximum(size - 1.0, 0.0), values)
