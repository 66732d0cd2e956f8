"""A photograph with levels that are linear in light, and all that is known of it."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from acquisition.choices import Pattern
from acquisition.devices import CameraSettings
from acquisition.errors import HintError, ImageFileError
from acquisition.photographs._encoding import (
    LINEAR,
    REC601_LUMA,
    SRGB,
    Encoding,
    luma_plane,
    on_screen,
    white_level_dn,
)
from acquisition.photographs._mosaic import UNNAMED_MOSAIC, seems_mosaic
from acquisition.photographs._stored_image import (
    FROM_CHROMA,
    CodedSteps,
    JpegCoding,
    PhotographFacts,
    coded_variance,
)
from acquisition.printable import on_one_line
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.by_value import ByValue
from simulation.notebook import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_PLATEAU_FRACTION = 0.002
_CLIPPED_FROM = 0.995  # of the saturation level
_ADC_BITS = (10, 12, 14)
_ABRUPT = 0.012
"""Of the range of the levels: the last step before a plateau is larger where they were cut off.
Rendered edges of 0.4 to 4 px come to theirs in steps below 0.001, in 8 bits below 0.008."""
_LEAST_BESIDE_PX = 20
_SOLID = 0.4
"""Of a pixel and its eight neighbours."""
_ABOVE_ALL = 1.02
"""Beyond what counts as nearly saturated."""
_BRIGHTEST = 99.9  # percentile shown as white, so that a single hot pixel does not darken all
_LOST_AROUND_PX, _HALVED_PX = 1.5, np.float32(4.0)
_USUAL_SAMPLING = (True, True)
"""Whether JPEG's chroma has half the rows and half the columns, where a file does not tell."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotographHead(ByValue):
    """Facts about a photograph, without its pixels.

    ``encoding_from`` is what decided the encoding, as a noun: ``its ICC profile sRGB``;
    ``is_encoding_stated`` says that it is not just what is usual. ``left_out`` is what the file
    holds beside light.
    """

    path: Path
    encoding: Encoding = LINEAR
    encoding_from: str = ""
    is_encoding_stated: bool = False
    facts: PhotographFacts = field(default_factory=PhotographFacts)
    pattern: Pattern | None = None
    sha256: str | None = None
    left_out: str = ""

    @property
    def name(self) -> str:
        """The path on one line, with the control characters of a terminal escaped."""
        return on_one_line(self.path)

    @property
    def encoding_sentence(self) -> str:
        """The encoding that was used, why, and how to override it, in words."""
        if self.encoding_from == "--encoding":
            return f"levels taken as {self.encoding.name} (--encoding)"
        return (
            f"levels taken as {self.encoding.name} ({self.encoding_from}); "
            "--encoding overrides this"
        )

    @property
    def remarks(self) -> dict[str, str]:
        """Remarks to make once for each kind of file, by kind."""
        said = {}
        if self.encoding_from:
            encoding = f"encoding {self.encoding.name} {self.encoding_from}"
            said[encoding] = f"{self.name}: {self.encoding_sentence}"
        if self.left_out:
            said[f"beside {self.left_out}"] = f"{self.name}: not used: {self.left_out}"
        if self.facts.turn is not None:
            said[f"turn {self.facts.turn}"] = (
                f"{self.name}: viewers show it {self.facts.turn}; rows and columns here are those "
                "of the file"
            )
        return said | self._further_remarks()

    def _further_remarks(self) -> dict[str, str]:
        return {}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FileSteps:
    """Effect of a file's quantisation steps on its levels; None if it does not hold integers.

    The variance of each grey level ``(rows, cols)`` by them, the level of one step, and both by
    channel. ``channel_covariance``: of the stored red, green and blue, shape ``(3, 3)``, in squared
    codes. ``coded``: steps of the coefficients of a JPEG, None of other files.
    """

    variance_dn2: Float32Array | None = field(default=None, repr=False)
    step_dn: Float32Array | None = field(default=None, repr=False)
    channel_variance_dn2: Float32Array | None = field(default=None, repr=False)
    channel_step_dn: Float32Array | None = field(default=None, repr=False)
    channel_covariance: FloatArray | None = field(default=None, repr=False)
    coded: CodedSteps | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Photograph(PhotographHead):
    """One photograph as it was stored, and its levels linear in light.

    Parameters
    ----------
    stored
        Levels as the file holds them, shape ``(rows, cols)`` or ``(rows, cols, 3)``.
    full_scale_dn
        Level of white: the largest that the stored numbers can hold; None for floats.
    saturation_dn
        Linear level at which the sensor clips; None if the file does not show it.
    is_jpeg
        Whether the levels were compressed as JPEG.
    luma_steps
        For a JPEG file, the quantisation table of its luma, shape ``(8, 8)``, rows by vertical
        frequency; the blocks start at the first pixel.
    jpeg_coding
        How a JPEG file was coded, if another photograph can be coded in the same way.
    variance_dn2, frames
        For the mean of a stack, the temporal variance of one frame and the number of frames.
    has_modelled_variance
        Whether that variance is from a noise model, as for an exposure bracket, and not a sample
        variance.
    masked
        Pixels that an array's mask marks as no measurement, shape ``(rows, cols)``; None if there
        are none. They have the levels of the nearest measured pixels.
    """

    stored: AnyArray = field(repr=False)
    full_scale_dn: float | None = None
    saturation_dn: float | None = None
    is_jpeg: bool = False
    luma_steps: FloatArray | None = field(default=None, repr=False)
    jpeg_coding: JpegCoding | None = None
    variance_dn2: FloatArray | None = field(default=None, repr=False)
    frames: int = 1
    has_modelled_variance: bool = False
    masked: BoolArray | None = field(default=None, repr=False)

    def _further_remarks(self) -> dict[str, str]:
        is_unnamed = self.pattern is None and self.stored.ndim == 2 and not self.is_jpeg
        if not is_unnamed or not seems_mosaic(self.stored):
            return {}
        return {
            UNNAMED_MOSAIC: f"{self.name}: its levels alternate from pixel to pixel like those of "
            "a colour camera's raw mosaic; if it is one, standoff calibrate --bayer measures it; "
            "for anything else, develop it first"
        }

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.colour_planes, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        rows, cols = self.stored.shape[:2]
        kind = f"{self.pattern} mosaic" if self.pattern else "colour" if self.is_colour else "grey"
        return (
            f"<Photograph {on_one_line(self.path.name)}: {cols} x {rows} px, {kind}, "
            f"{self.encoding.name}>"
        )

    def _repr_html_(self) -> str:
        facts = [
            (name.replace("_", " "), str(value)) for name, value in self.facts.to_json().items()
        ]
        return html_table(repr(self)[1:-1], ("of the file", ""), facts)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the photograph as a screen would show it, in the sensor's axes."""
        from simulation.figures import drawn  # matplotlib, for whoever looks

        shown = self._on_screen

        def draw(axes: "Axes") -> None:
            axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0)
            axes.set(title=self.path.name, xlabel="x / px", ylabel="y / px")

        return drawn(draw, ax, (6.4, 6.4 * shown.shape[0] / shown.shape[1] + 0.6))

    @property
    def _on_screen(self) -> FloatArray:
        planes = np.asarray(self.linear_planes, dtype=np.float64)
        if self.is_colour:
            return on_screen(planes, white_level_dn(planes))
        dark = planes.min()
        bright = max(float(np.percentile(planes, _BRIGHTEST)), dark + 1e-9)
        return SRGB.encode(np.clip((planes - dark) / (bright - dark), 0.0, 1.0), 1.0)

    @property
    def is_colour(self) -> bool:
        """Whether there are red, green and blue planes."""
        return self.stored.ndim == 3

    @property
    def linear_planes(self) -> AnyArray:
        """Linear levels, in a number type that the capture model takes.

        For a linear file they are the stored numbers, in their own type.
        """
        pixels = self.stored
        if not self.encoding.is_linear:
            return self.encoding.decode(pixels, self.white_dn)
        if pixels.dtype.type in (np.uint8, np.uint16, np.float32, np.float64):
            return pixels
        return pixels.astype(np.float64)

    @property
    def colour_planes(self) -> AnyArray:
        """``linear_planes`` of a photograph that is neither a raw mosaic nor masked.

        Raises
        ------
        ImageFileError
            If it is a raw mosaic, or some pixels are masked.
        """
        self.refuse_mosaic()
        if self.masked is not None:
            raise ImageFileError(
                f"{self.name}: {np.count_nonzero(self.masked)} of its {self.masked.size} pixels "
                "are masked, and all of them are needed here; fill them (numpy.ma.filled), or cut "
                "out a part without"
            )
        return self.linear_planes

    def not_measured(self, *, is_clipped: bool = False) -> BoolArray | None:
        """Mask of pixels that are masked or, with ``is_clipped``, clipped; None without any."""
        found = self.masked
        if is_clipped and self.saturation_dn is not None:
            planes: FloatArray = np.asarray(self.linear_planes, dtype=np.float64)
            at_white = planes >= _CLIPPED_FROM * self.saturation_dn
            clipped = np.asarray(at_white if at_white.ndim == 2 else at_white.any(axis=2))
            found = clipped if found is None else found | clipped
        return found if found is not None and found.any() else None

    @property
    def filled(self) -> "Photograph":
        """The photograph without its mask, for callers that leave out ``masked`` themselves."""
        return self if self.masked is None else replace(self, masked=None)

    def refuse_mosaic(self) -> None:
        """Refuse a raw mosaic, whose pixels have different colours.

        Raises
        ------
        ImageFileError
            If it is a raw mosaic.
        """
        if self.pattern is not None:
            raise ImageFileError(
                f"{self.name}: a raw mosaic; standoff calibrate measures its PSF; for anything "
                "else, develop it to a linear TIFF"
            )

    @property
    def grey_dn(self) -> FloatArray:
        """Linear grey levels, shape ``(rows, cols)``; for colours, their Rec. 601 luma.

        Raises
        ------
        ImageFileError
            If it is a raw mosaic.
        """
        return luma_plane(self.colour_planes)

    @property
    def shown_dn(self) -> AnyArray:
        """Linear levels to show the photograph by: its colours if it has any, or else ``grey_dn``.

        Raises
        ------
        ImageFileError
            If it is a raw mosaic.
        """
        return self.colour_planes if self.is_colour else self.grey_dn

    @property
    def grey_variance_dn2(self) -> FloatArray | None:
        """Temporal variance of the grey levels of one frame; None if it is not known."""
        if self.variance_dn2 is None or self.variance_dn2.ndim == 2:
            return self.variance_dn2
        weights = np.square(REC601_LUMA)
        return np.asarray(self.variance_dn2[:, :, :3] @ weights)

    def taken_as(self, encoding: Encoding, encoding_from: str) -> "Photograph":
        """The photograph, its stored levels decoded by ``encoding``; ``encoding_from`` says why."""
        saturation = self.saturation_dn
        if saturation is not None:
            top = np.full((1, 1, 3), saturation)
            stored = self.encoding.encode(top, self.white_dn)
            saturation = float(encoding.decode(stored, self.white_dn).max())
        return replace(
            self, encoding=encoding, encoding_from=encoding_from, saturation_dn=saturation
        )

    def coded_as(self, other: "Photograph") -> "Photograph":
        """The photograph as a file coded like that of another photograph would hold it.

        It is recoded only if the other one is a JPEG, or the coarser JPEG of the two, with levels
        of the same kind. Without that, what coding removes from only one of them would look like a
        change, or like blur.
        """
        coding, own = other.jpeg_coding, self.jpeg_coding
        if (
            coding is None
            or coding == own
            or (own is not None and own.coarseness >= coding.coarseness)
            or self.stored.dtype != np.uint8
            or self.stored.ndim != other.stored.ndim
            or self.encoding.name != other.encoding.name
        ):
            return self
        coded = coding.of_levels(self.stored)
        if self.has_halved_chroma and any(coding.halved):
            # Halved once more, small things would lose colour: their luma alone is coded.
            luma = np.asarray(REC601_LUMA)
            stored = self.stored.astype(np.float64)
            more = (coded.astype(np.float64) - stored) @ luma
            coded = np.clip(np.rint(stored + more[..., np.newaxis]), 0, 255).astype(np.uint8)
        return replace(self, stored=coded)

    @property
    def file_steps(self) -> FileSteps:
        """Variance and size of the quantisation steps, for grey levels and each colour channel.

        The variance is a twelfth of the squared step of each channel, after decoding. For a JPEG
        file, each quantisation step of a coefficient gives the density of the error at its
        frequency, weighted by a Gaussian of 1 px: the result is the variance of the white noise
        that would be as large after such smoothing.
        """
        if self.stored.dtype.kind != "u" or self.pattern is not None:
            return FileSteps()
        slopes = self._decoding_slopes
        squares, coded = self._squared_steps_dn2(slopes)
        grey = FileSteps(
            variance_dn2=(squares / 12 + coded).astype(np.float32),
            step_dn=np.sqrt(squares + coded).astype(np.float32),
            coded=self.coded_steps,
        )
        if not self.is_colour:
            return grey
        each = np.square(slopes.astype(np.float32))
        by_coefficients = self._coded_covariance
        lost = np.diag(by_coefficients).astype(np.float32)
        return replace(
            grey,
            channel_variance_dn2=each * (np.float32(1 / 12) + lost),
            channel_step_dn=np.sqrt(each * (1 + lost)),
            channel_covariance=np.eye(3) / 12 + by_coefficients,
        )

    @property
    def coded_steps(self) -> CodedSteps | None:
        """Steps of a JPEG's coefficients; None of other files."""
        if self.luma_steps is None:
            return None
        coding = self.jpeg_coding
        if coding is None:
            return CodedSteps(luma=self.luma_steps, chroma=self.luma_steps, halved=_USUAL_SAMPLING)
        return CodedSteps(luma=self.luma_steps, chroma=coding.chroma_steps, halved=coding.halved)

    @property
    def _coded_covariance(self) -> FloatArray:
        """Covariance of the stored red, green and blue by the coefficients of a JPEG."""
        coded = self.coded_steps
        if coded is None:
            return np.zeros((3, 3))
        luma, chroma = coded.variance()
        # Errors of luma, blue and red chroma, as the channels are made of them.
        return np.asarray(luma + chroma * FROM_CHROMA @ FROM_CHROMA.T)

    @property
    def has_halved_chroma(self) -> bool:
        """Whether colours have half the rows or half the columns of the luma, as in most JPEGs."""
        if not self.is_jpeg or not self.is_colour:
            return False
        return any(_USUAL_SAMPLING if self.jpeg_coding is None else self.jpeg_coding.halved)

    def with_colours_halved_as(self, other: "Photograph") -> "Photograph":
        """The photograph with as few pixels for its colours as the JPEG ``other`` has.

        Itself, where it has no more of them, or levels that no JPEG has.
        """
        coding = other.jpeg_coding
        is_codable = self.is_colour and self.stored.dtype == np.uint8
        if (
            coding is None
            or not other.has_halved_chroma
            or self.has_halved_chroma
            or not is_codable
        ):
            return self
        stored = coding.finest.of_levels(self.stored)
        return replace(self, stored=stored, is_jpeg=True, jpeg_coding=coding.finest)

    @property
    def halved_colours_variance_dn2(self) -> Float32Array | None:
        """Variance of each channel by the pixels that its colours lack, ``(rows, cols, 3)``.

        It is what halving does that begins a pixel further. The errors are those of squares of two
        by two pixels, so that behind a filter four of them count as one. None without halving.
        """
        coding = self.jpeg_coding
        if coding is None or not self.has_halved_chroma or self.stored.dtype != np.uint8:
            return None
        beside = np.pad(self.stored, ((1, 1), (1, 1), (0, 0)), mode="edge")
        again = coding.finest.of_levels(beside)[1:-1, 1:-1]
        lost: FloatArray = self.encoding.decode(again, self.white_dn)
        lost = lost - self.encoding.decode(self.stored, self.white_dn)
        around = cv2.GaussianBlur(np.square(lost, dtype=np.float32), (0, 0), _LOST_AROUND_PX)
        return np.asarray(_HALVED_PX * around)

    def _squared_steps_dn2(self, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Squared steps of the stored levels in grey, and the variance of JPEG coefficients.

        Of colours the chroma's too: where the channels' levels stand for unequal light, as in
        saturated red, it is not neutral in light.
        """
        weights = np.asarray(REC601_LUMA) if self.is_colour else np.ones(1)
        planes = slopes.reshape(*slopes.shape[:2], -1)
        squares = np.square(planes) @ np.square(weights)
        coded = self.coded_steps
        if coded is None:
            return squares, np.zeros(1)
        by_luma = np.square(planes @ weights)
        if not self.is_colour:
            return squares, by_luma * coded_variance(coded.luma)
        luma, chroma = coded.variance()
        by_chroma = np.square(planes @ (weights[:, np.newaxis] * FROM_CHROMA)).sum(axis=-1)
        # The luma is rounded once more with the chroma.
        return squares, by_luma * (luma + 1 / 12) + by_chroma * chroma

    @property
    def _decoding_slopes(self) -> FloatArray:
        """Linear levels for a step of the stored ones, at each pixel of each channel."""
        count = int(self.white_dn) + 1
        if self.encoding.is_linear or count > 1 << 16:
            return np.ones(self.stored.shape)
        codes = np.arange(count, dtype=self.stored.dtype)
        channels = self.stored.shape[2:]
        table = np.broadcast_to(codes.reshape(-1, *(1 for _ in channels)), (count, *channels))
        levels = np.asarray(self.encoding.decode(table[:, np.newaxis], self.white_dn), np.float64)
        slopes = np.gradient(levels[:, 0], axis=0)
        if not channels:
            return np.asarray(slopes[self.stored])
        return np.stack([slopes[self.stored[..., c], c] for c in range(*channels)], axis=-1)

    @property
    def white_dn(self) -> float:
        """Level that decoding does not change: the largest stored level, 1 for floats."""
        return 1.0 if self.full_scale_dn is None else self.full_scale_dn

    def white_level_dn(self, stated: float | None) -> float | None:
        """Linear level at which the photograph is clipped; None if it is not known.

        Parameters
        ----------
        stated
            Clipping level that the caller states, in levels of the file; None for the file's own.

        Raises
        ------
        HintError
            If the file has no such level.
        """
        if stated is None:
            return self.saturation_dn
        full_scale = self.full_scale_dn
        if full_scale is not None and stated > full_scale:
            raise HintError(f"{self.name}: no level {stated:g}; its levels end at {full_scale:g}")
        level = np.full((1, 1, max(len(self.encoding.curves), 1)), float(stated))
        return float(self.encoding.decode(level, self.white_dn).max())


def full_scale_dn(pixels: AnyArray) -> float | None:
    """Largest level that numbers of this type can hold; None for floats."""
    if pixels.dtype.kind not in "ui":
        return None
    return float(2 ** (8 * pixels.dtype.itemsize - (pixels.dtype.kind == "i")) - 1)


def saturation_dn(pixels: AnyArray, full_scale: float | None) -> float | None:
    """Level of the clipping: of the file's numbers, or of a narrower ADC whose plateau shows."""
    if full_scale is None:
        return _cut_off_dn(pixels)
    top = float(pixels.max())
    adc_tops = {float(2**bits - 1) for bits in _ADC_BITS}
    if top in adc_tops and np.mean(pixels == pixels.dtype.type(top)) > _PLATEAU_FRACTION:
        return top
    return full_scale


def _cut_off_dn(pixels: AnyArray) -> float | None:
    """Level at which floats were cut off, or one above all where they were at 0 alone.

    Light comes to an even level in ever smaller steps; a cut meets its plateau with the whole step
    of its slope. Where it does so at both ends, it may be a drawing, and nothing is told.
    """
    low, high = float(pixels.min()), float(pixels.max())
    planes: Float32Array = np.asarray(pixels, dtype=np.float32).reshape(*pixels.shape[:2], -1)
    at_high, at_low = (np.asarray(planes == np.float32(end)) for end in (high, low))
    if not low < high:
        return None
    is_cut = _is_abrupt(planes, at_high, at_low), _is_abrupt(-planes, at_low, at_high)
    if is_cut == (True, False):
        return high
    return high * _ABOVE_ALL if is_cut == (False, True) and low == 0 else None


def _is_abrupt(planes: Float32Array, at_end: BoolArray, at_other: BoolArray) -> bool:
    """Whether the highest level of ``(rows, cols, channels)`` is a plateau of light cut off."""
    if not np.mean(at_end) > _PLATEAU_FRACTION:
        return False
    # A single pixel may well be the highest of its row.
    solid, other = (one.astype(np.float32).reshape(planes.shape) for one in (at_end, at_other))
    solid[cv2.blur(solid, (3, 3)).reshape(planes.shape) < _SOLID] = 0
    around = (cv2.dilate(one, np.ones((3, 3))).reshape(planes.shape) for one in (solid, other))
    beside, near_other = (np.asarray(one > 0) for one in around)
    beside &= ~at_end
    if np.count_nonzero(beside) < _LEAST_BESIDE_PX or np.mean(near_other[beside]) > 0.5:
        return False
    gaps = float(planes.max()) - planes[beside]
    return bool(np.median(gaps) > _ABRUPT * float(np.ptp(planes)))


def as_numbers(pixels: NDArray[Any]) -> NDArray[Any]:
    """The pixels as numbers: a bit is black or white of 8 bits, half floats become floats."""
    if pixels.dtype.kind == "b":
        return pixels.astype(np.uint8) * np.uint8(255)
    if pixels.dtype == np.float16:
        return pixels.astype(np.float32)
    return pixels.astype(pixels.dtype.newbyteorder("="), copy=False)


def light_planes(pixels: NDArray[Any]) -> tuple[NDArray[Any], bool]:
    """Grey levels ``(rows, cols)`` or colours ``(rows, cols, 3)``; whether an opacity varies."""
    if pixels.ndim == 2:
        return pixels, False
    light = 1 if pixels.shape[2] < 3 else 3
    others = pixels[:, :, light:]
    planes = pixels[:, :, 0] if light == 1 else pixels[:, :, :3]
    return planes, bool(others.size and np.ptp(others) > 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchCapture(ByValue):
    """The mean of several frames at one height, with their temporal variance.

    Every function of the library that takes an image takes a capture; ``numpy.asarray`` of it is
    ``mean_dn``.

    Parameters
    ----------
    mean_dn
        Mean level of each pixel, shape ``(rows, cols)``, in DN, linear in light, black level
        included.
    variance_dn2
        Temporal variance of one frame, same shape, in DN^2; that of the mean is ``variance_dn2 /
        frames_used``.
    height_mm
        Height read back from the stage.
    settings
        Settings read back from the camera: exposure, gain, pixel format, black level and others.
    saturated_pixels
        Number of pixels that reached the largest level in any frame.
    focus_value
        Squared-gradient focus value of the frame, without the share of the noise; dimensionless.
    """

    mean_dn: NDArray[np.float32] = field(repr=False)
    variance_dn2: NDArray[np.float32] = field(repr=False)
    height_mm: float
    frames_used: int
    settings: CameraSettings
    saturated_pixels: int
    focus_value: float

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.mean_dn, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        rows, cols = self.mean_dn.shape
        return (
            f"<BenchCapture at {self.height_mm:.3f} mm: {cols} x {rows} px, {self.frames_used} "
            f"frames of {self.exposure_us:g} us, focus {self.focus_value:.4g}>"
        )

    def _repr_html_(self) -> str:
        facts = [
            ("height / mm", f"{self.height_mm:.3f}"),
            ("frames", str(self.frames_used)),
            ("exposure / us", f"{self.exposure_us:g}"),
            ("gain / dB", "" if self.settings.gain_db is None else f"{self.settings.gain_db:g}"),
            ("saturated pixels", str(self.saturated_pixels)),
            ("focus value", f"{self.focus_value:.4g}"),
        ]
        return html_table("capture", ("", ""), facts)

    @property
    def exposure_us(self) -> float:
        """Exposure time of one frame, in us."""
        return self.settings.exposure_us

    @property
    def photograph(self) -> Photograph:
        """The capture as a `Photograph`, with its noise."""
        return Photograph(
            path=Path(f"capture at {self.height_mm:.3f} mm"),
            stored=self.mean_dn,
            saturation_dn=float(self.settings.max_level_dn),
            variance_dn2=self.variance_dn2.astype(np.float64),
            frames=self.frames_used,
        )

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the capture as a screen would show it."""
        return self.photograph.plot(ax)
