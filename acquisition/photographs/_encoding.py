"""From the levels of a file to light and back, and from light to a screen.

An encoding is linear, sRGB, a power, or the tone curve of an ICC profile, read from its bytes
(ICC.1:2022, profile version 4.4: 7.2 header, 7.3 tag table, 10.6 curveType, 10.18
parametricCurveType). Only the curves are needed: channels keep the primaries of the camera.

The white of the file keeps its level: of 8 bits, 255 stays 255. What lies above white (float files
alone can hold it) continues the slope at white, and what lies below black is mirrored.
"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import cv2
import numpy as np

from acquisition.choices import Channel
from acquisition.photographs._decoding import DecodingError
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
    """The curve from encoded to linear levels, both from 0 to 1, and its name.

    ``curves`` of ``icc`` holds linear levels at evenly spaced encoded ones, for all channels or
    each.
    """

    name: str
    curves: tuple[FloatArray, ...] = field(default=(), repr=False, compare=False)

    def __post_init__(self) -> None:
        is_known = self.name in ("linear", "srgb") or self.gamma is not None
        if not is_known and (self.name != "icc" or not self.curves):
            raise ValueError(
                f"{self.name!r} is not an encoding: expected linear, srgb or gamma:G, "
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
        """Return levels proportional to light, with the same white; channels lie along axis 2."""
        return self._mapped(levels, white_dn, [_decoded(curve) for curve in self._decoders()])

    def encode(self, levels: AnyArray, white_dn: float) -> FloatArray:
        """Return the levels that a file of this encoding stores; the inverse of ``decode``."""
        curves = zip(self._decoders(), self._encoders(), strict=True)
        return self._mapped(levels, white_dn, [_encoded(*pair) for pair in curves])

    def _decoders(self) -> list[_Curve]:
        if self.name == "srgb":
            return [_srgb_to_linear]
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


def _srgb_to_linear(encoded: FloatArray) -> FloatArray:
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


_WHITE_PERCENT = 99.8
"""Of the pixels' brightest channels: few lose their hue at white, and no hot pixel darkens all."""


def on_screen(colours_dn: AnyArray, white_dn: float) -> FloatArray:
    """Return colours as a screen takes them: the sRGB curve of each channel, from 0 to 1.

    White is the same level in all channels, so that hues are those of the photograph. NaN stays
    NaN.
    """
    share = np.asarray(colours_dn, dtype=np.float64) / white_dn
    return linear_to_srgb(np.clip(share, 0.0, 1.0))


def white_level_dn(colours_dn: AnyArray) -> float:
    """Return the level to show as white: that of the brightest channel of all but few pixels."""
    brightest = np.asarray(colours_dn).max(axis=-1)
    return max(float(np.percentile(brightest, _WHITE_PERCENT)), 1e-9)


def linear_to_srgb(linear: FloatArray) -> FloatArray:
    """IEC 61966-2-1:1999, section 5.3, from 0 to 1."""
    threshold = 0.04045 / 12.92
    power = 1.055 * np.maximum(linear, threshold) ** (1 / 2.4) - 0.055
    return np.where(linear <= threshold, linear * 12.92, power)


REC601_LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601-7, section 2.5.1


def luma_plane(image: AnyArray, channel: Channel = "luma") -> FloatArray:
    """Return one float64 plane of a grey or colour image; ``luma`` is that of Rec. 601.

    The shape is ``(rows, cols)``, or ``(rows, cols, 1 to 4)`` with an opacity that is ignored.
    """
    plane = np.asarray(image)
    if plane.ndim == 3 and plane.shape[2] in (1, 2):
        plane = plane[:, :, 0]
    if plane.ndim == 2:
        if channel != "luma":
            raise ValueError(f"a grey image has no {channel} channel")
        return plane.astype(np.float64)
    if plane.ndim != 3 or plane.shape[2] not in (3, 4):
        raise ValueError(f"an image has shape (rows, cols) or (rows, cols, 3), got {plane.shape}")
    colours = plane[:, :, :3].astype(np.float64)
    if channel == "luma":
        return np.asarray(colours @ np.array(REC601_LUMA))
    return np.asarray(colours[:, :, ("red", "green", "blue").index(channel)])


_SAMPLES = 4096
_SAME_CURVE = 1e-3  # of white
_MOST_ENTRIES = 1 << 16
_LARGEST_TAG = 12 + 2 * _MOST_ENTRIES
_CURVE_TAGS = {b"RGB ": (b"rTRC", b"gTRC", b"bTRC"), b"GRAY": (b"kTRC",)}
_PARAMETERS = (1, 3, 4, 5, 7)


class ProfileError(DecodingError):
    """Bytes are no ICC profile, or one whose channels have no tone curve."""

    def __init__(self, fault: str) -> None:
        super().__init__(f"{fault}; say with --encoding what its levels are")


@dataclass(frozen=True, slots=True, kw_only=True)
class _ColourProfile:
    """What a profile says of the levels: its name and the encoding."""

    name: str
    encoding: Encoding


def read_profile(data: bytes) -> _ColourProfile:
    """Read the encoding that a profile describes."""
    try:
        return _profile(data)
    except (struct.error, IndexError, OverflowError) as error:
        raise ProfileError("its colour profile is damaged") from error


def _profile(data: bytes) -> _ColourProfile:
    if data[36:40] != b"acsp":
        raise ProfileError("its colour profile is damaged")
    tags = _tags(data)
    names = _CURVE_TAGS.get(data[16:20])
    if names is None:
        space = data[16:20].decode("latin-1").strip()
        raise ProfileError(f"its colour profile is for {space}, not for RGB or grey")
    missing = [name for name in names if name not in tags]
    if missing:
        raise ProfileError("its colour profile has no tone curves")
    curves = [_curve(tags[name]) for name in names]
    if max(float(np.abs(curve - curves[0]).max()) for curve in curves) <= _SAME_CURVE:
        curves = curves[:1]
    return _ColourProfile(name=_description(tags.get(b"desc", b"")), encoding=_encoding(curves))


def _tags(data: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", data, 128)
    if count > 1000:
        raise ProfileError("its colour profile is damaged")
    places = [struct.unpack_from(">4sII", data, 132 + 12 * i) for i in range(count)]
    wanted = (b"desc", *_CURVE_TAGS.get(data[16:20], ()))
    return {
        name: data[start : start + min(size, _LARGEST_TAG)]
        for name, start, size in places
        if name in wanted
    }


def _curve(tag: bytes) -> FloatArray:
    """Linear levels at ``_SAMPLES`` evenly spaced encoded ones, rising from 0 to 1."""
    encoded = np.linspace(0.0, 1.0, _SAMPLES)
    if tag[:4] == b"para":
        linear = _parametric(tag, encoded)
    elif tag[:4] == b"curv":
        linear = _tabulated(tag, encoded)
    else:
        raise ProfileError("its colour profile has no tone curves")
    is_rising = np.all(np.isfinite(linear)) and np.all(np.diff(linear) >= 0)
    if not is_rising or linear[-1] - linear[0] < 0.5:
        raise ProfileError("the tone curve of its colour profile does not rise from 0 to 1")
    return np.asarray(np.maximum(linear, 0.0) / linear[-1])


def _tabulated(tag: bytes, encoded: FloatArray) -> FloatArray:
    (count,) = struct.unpack_from(">I", tag, 8)
    if count == 0:
        return encoded
    if count > _MOST_ENTRIES or len(tag) < 12 + 2 * count:
        raise ProfileError("its colour profile is damaged")
    entries = np.frombuffer(tag, ">u2", count, 12)
    if count == 1:
        return np.asarray(encoded ** (float(entries[0]) / 256.0))
    return np.interp(encoded, np.linspace(0.0, 1.0, count), entries / 65535.0)


def _parametric(tag: bytes, encoded: FloatArray) -> FloatArray:
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind >= len(_PARAMETERS):
        raise ProfileError("its colour profile is damaged")
    numbers = struct.unpack_from(f">{_PARAMETERS[kind]}i", tag, 12)
    g, a, b, c, d, e, f = [number / 65536.0 for number in numbers] + [0.0] * (7 - len(numbers))
    if kind == 0:
        a, b, d = 1.0, 0.0, -1.0
    elif kind in (1, 2):
        # Below -b/a the power is cut off; c is an offset there (0 in kind 1).
        c, d, e, f = 0.0, (-b / a if a else 0.0), c, c
    with np.errstate(all="ignore"):
        power = np.maximum(a * encoded + b, 0.0) ** g + e
    return np.asarray(np.where(encoded >= d, power, c * encoded + f))


def _encoding(curves: list[FloatArray]) -> Encoding:
    """The encoding by its usual name where the curve has one."""
    encoded = np.linspace(0.0, 1.0, _SAMPLES)
    if len(curves) == 1:
        (curve,) = curves
        if np.abs(curve - encoded).max() <= _SAME_CURVE:
            return LINEAR
        if np.abs(curve - _srgb_to_linear(encoded)).max() <= _SAME_CURVE:
            return SRGB
        middle = np.interp(0.5, encoded, curve)
        gamma = round(float(np.log(max(middle, 1e-6)) / np.log(0.5)), 3)
        if 0.2 <= gamma <= 10 and np.abs(curve - encoded**gamma).max() <= _SAME_CURVE:
            return Encoding(name=f"gamma:{gamma:g}")
    return Encoding(name="icc", curves=tuple(curves))


def _description(tag: bytes) -> str:
    """The profile's name, of version 2 (desc) or 4 (mluc); empty where there is none."""
    if tag[:4] == b"desc" and len(tag) >= 12:
        (length,) = struct.unpack_from(">I", tag, 8)
        text = tag[12 : 12 + min(length, 200)].split(b"\0")[0].decode("ascii", "replace")
    elif tag[:4] == b"mluc" and len(tag) >= 28:
        length, start = struct.unpack_from(">II", tag, 20)
        text = tag[start : start + min(length, 400)].decode("utf-16-be", "replace")
    else:
        return ""
    return "".join(letter for letter in text if letter.isprintable()).strip()
