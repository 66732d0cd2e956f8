"""The tone curve of an ICC profile, read from its bytes.

ICC.1:2022 (profile version 4.4): 7.2 header, 7.3 tag table, 10.6 curveType, 10.18
parametricCurveType. Only the curves are needed: channels keep the primaries of the camera.
"""

import struct
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from standoff.photographs.encoding import LINEAR, SRGB, Encoding, srgb_to_linear
from standoff.photographs.stored import DecodingError

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
class ColourProfile:
    """What a profile says of the levels: its name and the encoding."""

    name: str
    encoding: Encoding


def read_profile(data: bytes) -> ColourProfile:
    """Read the encoding that a profile describes.

    Raises
    ------
    ProfileError
        If the bytes are damaged, or the profile has tables in place of curves.
    """
    try:
        return _profile(data)
    except (struct.error, IndexError, OverflowError) as error:
        raise ProfileError("its colour profile is damaged") from error


def _profile(data: bytes) -> ColourProfile:
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
    return ColourProfile(name=_description(tags.get(b"desc", b"")), encoding=_encoding(curves))


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
        if np.abs(curve - srgb_to_linear(encoded)).max() <= _SAME_CURVE:
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
