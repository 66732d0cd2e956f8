"""What a format's reader gives: pixels as stored, and what the file says of them.

Exif 3.0 (CIPA DC-008-2023), sections 4.6.4 to 4.6.6. A tag that is damaged or absent is None.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from io import BytesIO
from numbers import Real
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile, get_sampling
from scipy.fft import idct

from acquisition.choices import Pattern
from acquisition.photographs._encoding import LINEAR, Encoding
from simulation.arrays import AnyArray, FloatArray

_MM_PER_RESOLUTION_UNIT: dict[float, float] = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
TOP_TO_BOTTOM = 4
_TURNS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    TOP_TO_BOTTOM: "mirrored top to bottom",
    5: "mirrored and turned by 90 degrees",
    6: "turned by 90 degrees clockwise",
    7: "mirrored and turned by 270 degrees",
    8: "turned by 90 degrees anticlockwise",
}

ORIENTATION, MAKE, MODEL, DATE = 0x0112, 0x010F, 0x0110, 0x0132
EXPOSURE_TIME, F_NUMBER, ISO = 0x829A, 0x829D, 0x8827
DATE_TAKEN, FOCAL_LENGTH, COLOUR_SPACE = 0x9003, 0x920A, 0xA001
PIXELS_X, FOCAL_PLANE_X, FOCAL_PLANE_UNIT = 0xA002, 0xA20E, 0xA210
LENS_MAKE, LENS_MODEL = 0xA433, 0xA434
FACT_TAGS = frozenset({ORIENTATION, MAKE, MODEL, DATE, EXPOSURE_TIME, F_NUMBER, ISO, DATE_TAKEN,
                       FOCAL_LENGTH, COLOUR_SPACE, PIXELS_X, FOCAL_PLANE_X, FOCAL_PLANE_UNIT,
                       LENS_MAKE, LENS_MODEL})  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographFacts:
    """What a photograph's file says of its taking; None is what it does not say.

    ``orientation`` is Exif's number, 1 to 8; pixels are never turned here. ``pixel_pitch_um``
    follows from the resolution in the focal plane: of the file's pixels, maybe resampled.
    """

    camera: str | None = None
    lens: str | None = None
    focal_length_mm: float | None = None
    f_number: float | None = None
    exposure_s: float | None = None
    iso: float | None = None
    pixel_pitch_um: float | None = None
    taken: str | None = None
    orientation: int | None = None

    @classmethod
    def of_tags(cls, tags: Mapping[int, object], width_px: int) -> Self:
        """Read the facts from the tags by number; a picture that was scaled has no pitch."""
        make, model = _text(tags.get(MAKE)), _text(tags.get(MODEL))
        if make and model and not model.lower().startswith(make.split()[0].lower()):
            model = f"{make} {model}"
        orientation = _number(_first(tags.get(ORIENTATION)))
        return cls(
            camera=model or make,
            lens=_text(tags.get(LENS_MODEL)) or _text(tags.get(LENS_MAKE)),
            focal_length_mm=_positive(tags.get(FOCAL_LENGTH)),
            f_number=_positive(tags.get(F_NUMBER)),
            exposure_s=_positive(tags.get(EXPOSURE_TIME)),
            iso=_positive(_first(tags.get(ISO))),
            pixel_pitch_um=_pitch_um(tags, width_px),
            taken=_text(tags.get(DATE_TAKEN)) or _text(tags.get(DATE)),
            orientation=int(orientation or 0) if orientation in range(1, 9) else None,
        )

    @property
    def turn(self) -> str | None:
        """How viewers show the picture against its stored pixels; None where they do not turn."""
        return _TURNS.get(self.orientation or 1)

    def to_json(self) -> dict[str, object]:
        """Return what is known, by name."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def shared_facts(photographs: Sequence[PhotographFacts]) -> dict[str, Any]:
    """What several photographs say alike, by name: not their times, nor how they were turned."""
    if not photographs:
        return {}
    first, *others = [each.to_json() for each in photographs]
    return {
        name: value
        for name, value in first.items()
        if name not in ("taken", "orientation") and all(each.get(name) == value for each in others)
    }


def is_srgb(tags: Mapping[int, object]) -> bool:
    """Whether Exif's ColorSpace says sRGB; its other values decide nothing."""
    return _number(_first(tags.get(COLOUR_SPACE))) == 1


def _pitch_um(tags: Mapping[int, object], width_px: int) -> float | None:
    resolution = _positive(tags.get(FOCAL_PLANE_X))
    unit_mm = _MM_PER_RESOLUTION_UNIT.get(_number(_first(tags.get(FOCAL_PLANE_UNIT))) or 2)
    taken_px = _number(_first(tags.get(PIXELS_X)))
    if resolution is None or unit_mm is None or (taken_px is not None and taken_px != width_px):
        return None
    pitch_um = 1000.0 * unit_mm / resolution
    return pitch_um if 0.3 < pitch_um < 100 else None


def _positive(value: object) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _number(value: object) -> float | None:
    """A finite number of a tag: plain, or the first ratio of two integers."""
    try:
        if isinstance(value, tuple | list) and len(value) >= 2 and isinstance(value[0], int):
            value = value[0] / value[1]
        value = _first(value)
        if not isinstance(value, Real):
            return None
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) else None


def _first(value: object) -> object:
    """A plain value, or the first of several."""
    if isinstance(value, tuple | list):
        return value[0] if value else None
    return value


def _text(value: object) -> str | None:
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if not isinstance(value, str):
        return None
    kept = "".join(letter for letter in value.split("\0")[0] if letter.isprintable()).strip()
    return kept[:120] or None


_KNOWN_SAMPLINGS = (0, 1, 2)
"""4:4:4, 4:2:2 and 4:2:0, which Pillow writes."""

FROM_CHROMA = np.array([[0.0, 1.402], [-0.344136, -0.714136], [1.772, 0.0]])
"""Red, green and blue by blue and red chroma: ITU-T T.871 (2011), section 7."""

_SIZE = 8
"""Of a block of coefficients."""

_FREQUENCIES = 1024
"""Of the spectra of their patterns: enough for filters of 100 px."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JpegCoding:
    """Tables and sampling of a JPEG file.

    ``tables`` are those of its components, 64 steps each, rows by vertical frequency; ``sampling``
    is 0 for 4:4:4, 1 for 4:2:2, 2 for 4:2:0, -1 of a grey one.
    """

    tables: tuple[tuple[int, ...], ...] = field(repr=False)
    sampling: int

    @classmethod
    def of(cls, image: Image.Image) -> Self | None:
        """Read it off an image; None where it is another than Pillow writes."""
        if not isinstance(image, JpegImageFile) or image.mode not in ("L", "RGB"):
            return None
        sampling = get_sampling(image)
        if image.mode == "RGB" and sampling not in _KNOWN_SAMPLINGS:
            return None
        tables = tuple(tuple(image.quantization[key]) for key in sorted(image.quantization))
        return cls(tables=tables, sampling=sampling)

    @property
    def chroma_steps(self) -> FloatArray:
        """Table of the chroma, shape ``(8, 8)``; that of the luma where there is no other."""
        return np.array(self.tables[min(1, len(self.tables) - 1)], np.float64).reshape(_SIZE, _SIZE)

    @property
    def halved(self) -> tuple[bool, bool]:
        """Whether the chroma has half the rows, and half the columns."""
        return self.sampling == _KNOWN_SAMPLINGS[2], self.sampling in _KNOWN_SAMPLINGS[1:]

    @property
    def coarseness(self) -> int:
        """Sum of the steps of the first table, the luma's."""
        return sum(self.tables[0])

    @property
    def finest(self) -> "JpegCoding":
        """The same sampling with steps of 1."""
        return replace(self, tables=((1,) * _SIZE**2,) * len(self.tables))

    def of_levels(self, stored: AnyArray) -> AnyArray:
        """Code levels of 8 bits, shape ``(rows, cols)`` or ``(rows, cols, 3)``, and decode them."""
        file = BytesIO()
        how = {"subsampling": self.sampling} if stored.ndim == 3 else {}
        Image.fromarray(np.ascontiguousarray(stored)).save(
            file, "JPEG", qtables=[list(table) for table in self.tables], **how
        )
        return np.asarray(Image.open(BytesIO(file.getvalue())))


def coded_variance(
    steps: FloatArray, halved: tuple[bool, bool] = (False, False), width_px: float = 1.0
) -> float:
    """Variance of white noise as large as the coefficients' errors are, behind a Gaussian.

    An error is even over its step, of ``steps``, shape ``(8, 8)``. Along axes that are ``halved``,
    pixels between the coded ones are interpolated linearly.
    """
    frequency: FloatArray = np.asarray(np.fft.fftfreq(_FREQUENCIES), dtype=np.float64)
    kept = np.exp(-((2 * np.pi * width_px * frequency) ** 2))
    rows, columns = (_spectra(frequency, is_half) @ kept / kept.sum() for is_half in halved)
    return float(rows @ (np.square(np.asarray(steps, dtype=np.float64)) / 12) @ columns)


def _spectra(frequency: FloatArray, is_half: bool) -> FloatArray:
    """Mean power of each coefficient's pattern a pixel, shape ``(8, frequencies)``."""
    patterns = idct(np.eye(_SIZE), axis=1, norm="ortho")
    if is_half:
        patterns = np.repeat(patterns, 2, axis=1)
    spectra = np.square(np.abs(np.fft.fft(patterns, len(frequency), axis=1))) / patterns.shape[1]
    # Interpolated pixels are repeated ones behind weights of 1, 2 and 1.
    return spectra * np.cos(np.pi * frequency) ** 4 if is_half else spectra


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CodedSteps:
    """Steps of the coefficients of a JPEG's luma and chroma, shape ``(8, 8)`` each.

    ``halved``: whether the chroma has half the rows, and half the columns.
    """

    luma: FloatArray
    chroma: FloatArray
    halved: tuple[bool, bool]

    def variance(self, width_px: float = 1.0) -> tuple[float, float]:
        """Of luma and of either plane of chroma, in squared codes: see `coded_variance`.

        Both are rounded before they are transformed.
        """
        luma = coded_variance(np.hypot(self.luma, 1), width_px=width_px)
        return luma, coded_variance(np.hypot(self.chroma, 1), self.halved, width_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredImage:
    """The pixels of one image or of each page of a stack, before any decoding of levels.

    ``page`` reads one of ``count`` images, from 0, shape ``(rows, cols)`` or ``(rows, cols,
    channels)``. ``marked`` gives the encoding that the file states, or raises DecodingError;
    ``unmarked`` is that where nothing is stated. ``white_dn`` is None for floats. ``luma_steps`` is
    the quantisation table of a JPEG's luma, shape ``(8, 8)``, ``jpeg_coding`` what another takes to
    be coded alike. ``has_modelled_variance`` says that the noise model gives ``variance_dn2``, as
    of a bracket.
    """

    count: int
    page: Callable[[int], NDArray[Any]] = field(repr=False)
    marked: Callable[[], tuple[Encoding, str] | None] = field(default=lambda: None, repr=False)
    unmarked: tuple[Encoding, str] = (LINEAR, "")
    facts: PhotographFacts = field(default_factory=PhotographFacts)
    is_jpeg: bool = False
    luma_steps: FloatArray | None = field(default=None, repr=False)
    jpeg_coding: JpegCoding | None = None
    white_dn: float | None = None
    saturation_dn: float | None = None
    pattern: Pattern | None = None
    variance_dn2: FloatArray | None = field(default=None, repr=False)
    frames: int = 1
    has_modelled_variance: bool = False
    has_opacity: bool = False
    left_out: str = ""
