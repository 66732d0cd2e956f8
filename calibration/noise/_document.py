"""The measured noise of a camera, as noise.json stores it, and its dark, flat and defect maps."""

import hashlib
import os
from dataclasses import dataclass
from io import BytesIO
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Self

import cv2
import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator
from scipy.special import chdtri, ndtr

from acquisition.dataframe import dataframe
from acquisition.files import Provenance, StoredModel
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session import write_shared
from acquisition.untrusted import TiffDamageError, read_tiff
from calibration.errors import NoiseFileError
from calibration.noise._pattern import (
    PatternParts,
    PatternSpectra,
    pattern_parts,
    pattern_spectra,
    share_passed,
)
from calibration.noise._photon_transfer import LevelSample, PhotonTransfer
from calibration.robust import robust_sigma
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray, FloatImage
from simulation.by_value import ByValue
from simulation.capture_noise import CaptureNoise
from simulation.notebook import Shown

if TYPE_CHECKING:
    from pandas import DataFrame

DARK_DEFECT, RESPONSE_DEFECT, NOISE_DEFECT = 1, 2, 4
"""Bits of the defect map: wrong dark level, wrong response, too noisy."""

_SIGMAS = 6.0  # of 450 000 good pixels, 0.001 are beyond it
_LEAST_RESPONSE = 0.05
_NOISE_RATIO = 3.0
_MEDIAN_PX = 5
_SHADING_SIGMA_PX = 12.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectionMaps(ByValue):
    """Correction maps of one sensor, each of shape ``(rows, cols)``.

    ``dark_dn`` is the level without light, ``response`` the sensitivity relative to the mean over
    the sensor, including shading, and ``defects`` is 0 for good pixels, otherwise a combination of
    the bits `DARK_DEFECT`, `RESPONSE_DEFECT` and `NOISE_DEFECT`. ``black_level_dn`` is the level
    that a corrected image keeps without light.
    """

    dark_dn: Float32Array
    response: Float32Array
    defects: NDArray[np.uint8]
    black_level_dn: float

    def __post_init__(self) -> None:
        if not self.dark_dn.shape == self.response.shape == self.defects.shape:
            raise ValueError(
                "the maps must have one shape, got "
                f"{self.dark_dn.shape}, {self.response.shape}, {self.defects.shape}"
            )

    @property
    def is_defect(self) -> BoolArray:
        """Mask of the pixels with any defect, shape ``(rows, cols)``."""
        return self.defects > 0

    def correct(self, image_dn: AnyArray) -> FloatArray:
        """Return the image without fixed pattern, shading and defects; the black level is kept.

        Levels are ``(image - dark) / response + black``; a defective pixel gets the mean of its
        good neighbours.

        Raises
        ------
        ValueError
            If the image does not have the maps' shape.
        """
        self._require_shape(image_dn)
        light = (image_dn.astype(np.float64) - self.dark_dn) / self._divisor()
        return _filled(light, self.is_defect) + self.black_level_dn

    def correct_variance(self, variance_dn2: FloatImage) -> FloatArray:
        """Return the temporal variance of an image after ``correct``.

        Raises
        ------
        ValueError
            If the image does not have the maps' shape.
        """
        self._require_shape(variance_dn2)
        return _filled(variance_dn2.astype(np.float64) / self._divisor() ** 2, self.is_defect)

    def _divisor(self) -> FloatArray:
        return np.where(self.is_defect, 1.0, self.response).astype(np.float64)

    def _require_shape(self, image: AnyArray) -> None:
        if image.shape != self.dark_dn.shape:
            raise ValueError(
                f"an image of {image.shape} (rows, cols) does not match maps of "
                f"{self.dark_dn.shape}; use those of the same camera and region"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Nonuniformity:
    """How much the pixels differ, without temporal noise.

    ``shading`` is the range of the large-scale structure over its mean, the rest is without it.
    ``dark_parts_dn`` and ``response_parts`` split DSNU and PRNU into rows, columns and pixels;
    ``dark_spectra_dn`` and ``response_spectra`` are those of the two maps.
    """

    dark_parts_dn: PatternParts
    response_parts: PatternParts
    dark_spectra_dn: PatternSpectra
    response_spectra: PatternSpectra
    shading: float
    defects: int

    @property
    def dsnu_dn(self) -> float:
        """Standard deviation of the dark level between pixels."""
        return self.dark_parts_dn.total

    @property
    def prnu(self) -> float:
        """Standard deviation of the response between pixels, over its mean."""
        return self.response_parts.total


def _largest_by_chance(spread: float) -> float:
    """Ratio that a variance of this relative spread reaches as seldom as six standard deviations.

    A variance of n degrees of freedom is distributed as chi squared, with a spread of sqrt(2 / n).
    """
    if spread <= 0:
        return 1.0
    freedom = 2.0 / spread**2
    return float(chdtri(freedom, float(ndtr(-_SIGMAS))) / freedom)


def correction_maps(
    dark_dn: FloatImage,
    response: FloatImage,
    *,
    dark_noise_dn: float,
    variance_ratio: FloatImage,
    black_level_dn: float,
) -> CorrectionMaps:
    """Make the maps, and find the defects on them.

    A pixel is a defect if it differs from the median of its surroundings by six robust standard
    deviations of all pixels and by one frame's read noise in the dark or 5 % in its response, or if
    its temporal variance is three times that expected at its level and beyond what six standard
    deviations are of a normal distribution: of few frames a variance has a long tail.
    ``variance_ratio`` is averaged over captures.
    """
    defects = np.zeros(dark_dn.shape, dtype=np.uint8)
    defects[_stands_out(dark_dn, dark_noise_dn)] |= DARK_DEFECT
    defects[_stands_out(response, _LEAST_RESPONSE) | (response <= 0)] |= RESPONSE_DEFECT
    spread = robust_sigma(variance_ratio - np.median(variance_ratio))
    noisy = variance_ratio > max(_NOISE_RATIO, _largest_by_chance(spread))
    defects[noisy] |= NOISE_DEFECT
    return CorrectionMaps(
        dark_dn=dark_dn.astype(np.float32),
        response=response.astype(np.float32),
        defects=defects,
        black_level_dn=black_level_dn,
    )


def nonuniformity(
    maps: CorrectionMaps, *, dark_variance_dn2: float, response_variance: float
) -> Nonuniformity:
    """Measure DSNU, PRNU and shading on the maps.

    Defects are left out, and the temporal noise left in the maps is subtracted. Shading is of the
    light and the lens as well, and so the response is taken relative to its surroundings.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 8: the variance of the whole dark image,
    and that of the response after high-pass filtering.
    """
    sound = ~maps.is_defect
    from scipy.ndimage import gaussian_filter  # a quarter of a second, where maps are measured

    smooth = gaussian_filter(_filled(maps.response.astype(np.float64), maps.is_defect),
                             _SHADING_SIGMA_PX, mode="nearest")  # fmt: skip
    dark = maps.dark_dn.astype(np.float64)
    dark, response = dark - dark[sound].mean(), maps.response / smooth - 1.0
    passed = share_passed(_SHADING_SIGMA_PX)
    return Nonuniformity(
        dark_parts_dn=pattern_parts(dark, sound, dark_variance_dn2),
        response_parts=pattern_parts(response, sound, response_variance, passed),
        dark_spectra_dn=pattern_spectra(dark, sound, dark_variance_dn2),
        response_spectra=pattern_spectra(response, sound, response_variance),
        shading=float(np.ptp(smooth) / smooth.mean()),
        defects=int(np.count_nonzero(maps.defects)),
    )


def _stands_out(image: FloatImage, least: float) -> BoolArray:
    plane = np.ascontiguousarray(image, dtype=np.float32)
    left = plane - cv2.medianBlur(plane, _MEDIAN_PX)
    # The median absolute difference from a median of few values is a little too small.
    limit = max(_SIGMAS * robust_sigma(left), least)
    return np.asarray(np.abs(left) > limit)


def _filled(image: FloatArray, hole: BoolArray) -> FloatArray:
    """The image with holes filled from their rims inwards with the mean of known neighbours."""
    if not hole.any() or hole.all():
        return image
    filled = np.where(hole, 0.0, image)
    known = (~hole).astype(np.float64)
    while not known.all():
        total = cv2.boxFilter(filled * known, -1, (3, 3), normalize=False)
        count = cv2.boxFilter(known, -1, (3, 3), normalize=False)
        rim = (known == 0) & (count > 0.5)
        filled[rim] = total[rim] / count[rim]
        known[rim] = 1.0
    return filled


NOISE_SCHEMA: Final = "standoff.noise/1"

_MOST_FRAMES = 10**9  # a larger value is not a number of frames
_LEAST, _MOST = 1e-9, 1e9  # levels of photographs end at 1e9; beyond, variances overflow
_MOST_E = _MOST * _MOST  # the largest level at the largest gain
_NAMES = ("dark", "flat", "defects")
_TITLES = {
    "dark": "standoff noise: mean level without light, DN",
    "flat": "standoff noise: response relative to the mean of the sensor",
    "defects": "standoff noise: 1 dark, 2 response, 4 noise; 0 is a good pixel",
}


class MapFile(StoredModel):
    """The name of a map beside noise.json, and the SHA-256 of its bytes."""

    file: str
    sha256: str


class NoiseCalibration(Shown, ByValue, StoredModel, allow_inf_nan=False):
    """The noise of one camera at one gain, and the captures that it was measured from.

    Values whose names end in ``_err`` are standard errors; None, or null in a file, means not
    determined. Only the keys without a default are required. ``frames_averaged`` is the number of
    frames in an ordinary capture on the bench, not in the captures of ``levels``. ``maps`` names
    the files of the dark, flat and defect maps.
    """

    schema_name: Literal["standoff.noise/1"] = Field(default=NOISE_SCHEMA, alias="schema")
    gain_e_per_dn: float = Field(gt=0, ge=_LEAST, le=_MOST)
    gain_e_per_dn_err: float | None = None
    read_noise_e: float = Field(ge=0, le=_MOST_E)
    read_noise_e_err: float | None = None
    black_level_dn: float = Field(ge=-_MOST, le=_MOST)
    black_level_dn_err: float | None = None
    saturation_dn: float | None = None
    saturation_dn_err: float | None = None
    saturation_is_reached: bool | None = None
    saturation_e: float | None = None
    frames_averaged: int = Field(ge=1, le=_MOST_FRAMES)
    linearity_error: float | None = None
    linearity_worst: float | None = None
    light_drift_per_s: float | None = None
    light_flicker: float | None = None
    dark_current_e_per_s: float | None = None
    dark_current_e_per_s_err: float | None = None
    dsnu_e: float | None = None
    prnu: float | None = None
    shading: float | None = None
    defect_pixels: int | None = None
    fit_low_dn: float | None = None
    fit_high_dn: float | None = None
    chi2_reduced: float | None = None
    gain_db: float | None = None
    pixel_format: str | None = None
    camera_serial: str | None = None
    camera_model: str | None = None
    captured_utc: str | None = None
    darks: int | None = None
    flats: int | None = None
    notes: tuple[str, ...] = ()
    maps: dict[str, MapFile] | None = None
    levels: tuple[LevelSample, ...] = ()
    provenance: Provenance | None = None

    @field_validator(
        "gain_e_per_dn", "read_noise_e", "black_level_dn", "frames_averaged", mode="before"
    )
    @classmethod
    def _is_number(cls, value: object) -> object:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(  # noqa: TRY004 - pydantic does not catch a TypeError from a validator
                f"expected a number, got {value!r}"
            )
        return value

    @classmethod
    def of(cls, transfer: PhotonTransfer, pixels: Nonuniformity, **others: object) -> Self:
        """Return the calibration with these results; ``others`` are further fields by name."""
        dark, linearity = transfer.dark, transfer.linearity
        return cls.model_validate(
            {
                "gain_e_per_dn": transfer.gain_e_per_dn,
                "gain_e_per_dn_err": transfer.gain_e_per_dn_err,
                "read_noise_e": transfer.read_noise_e,
                "read_noise_e_err": transfer.read_noise_e_err,
                "black_level_dn": dark.black_level_dn,
                "black_level_dn_err": dark.black_level_dn_err,
                "saturation_dn": transfer.saturation.level_dn,
                "saturation_dn_err": transfer.saturation.err_dn,
                "saturation_is_reached": transfer.saturation.is_reached,
                "saturation_e": transfer.saturation_e,
                "linearity_error": linearity.mean_deviation if linearity else None,
                "linearity_worst": linearity.worst_deviation if linearity else None,
                "light_drift_per_s": linearity.light_drift_per_s if linearity else None,
                "light_flicker": transfer.light_flicker,
                "dark_current_e_per_s": dark.current_e_per_s,
                "dark_current_e_per_s_err": dark.current_e_per_s_err,
                "dsnu_e": pixels.dsnu_dn * transfer.gain_e_per_dn,
                "prnu": pixels.prnu,
                "shading": pixels.shading,
                "defect_pixels": pixels.defects,
                "fit_low_dn": transfer.fit_low_dn,
                "fit_high_dn": transfer.fit_high_dn,
                "chi2_reduced": transfer.chi2_reduced,
                "notes": transfer.notes,
                "levels": transfer.samples,
                **others,
            }
        )

    def to_dataframe(self) -> "DataFrame":
        """Return the captures as a pandas table, one row per capture.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.levels)

    @property
    def capture_noise(self) -> CaptureNoise:
        """The noise of an ordinary capture, in the form that simulations take."""
        return CaptureNoise(
            gain_e_per_dn=self.gain_e_per_dn,
            read_noise_e=self.read_noise_e,
            black_level_dn=self.black_level_dn,
            frames_averaged=self.frames_averaged,
        )

    def relative_err(self, levels_dn: ArrayLike) -> float | None:
        """Return the relative standard error of the noise at given levels; None if unknown.

        Parameters
        ----------
        levels_dn
            Levels of one or more pixels, in any shape; for several, the noise is the square root of
            their mean variance.
        """
        if self.gain_e_per_dn_err is None or self.read_noise_e_err is None:
            return None
        gain, read = self.gain_e_per_dn, self.read_noise_e
        light_dn = float(np.maximum(np.asarray(levels_dn) - self.black_level_dn, 0.0).mean())
        # Variance in DN^2 is light / gain + read^2 / gain^2.
        variance = light_dn / gain + (read / gain) ** 2
        by_gain = (light_dn / gain**2 + 2 * read**2 / gain**3) * self.gain_e_per_dn_err
        by_read = 2 * read / gain**2 * self.read_noise_e_err
        return 0.5 * hypot(by_gain, by_read) / variance if variance > 0 else None

    def __repr__(self) -> str:
        return (
            f"NoiseCalibration(gain {_with_err(self.gain_e_per_dn, self.gain_e_per_dn_err)} e/DN, "
            f"read noise {_with_err(self.read_noise_e, self.read_noise_e_err)} e, "
            f"black level {_with_err(self.black_level_dn, self.black_level_dn_err)} DN; "
            f"{len(self.levels)} captures)"
        )

    def __str__(self) -> str:
        return repr(self)


def _with_err(value: float, err: float | None) -> str:
    return f"{value:.4g}" if err is None else f"{value:.4f} ± {err:.4f}"


def map_paths(path: Path) -> dict[str, Path]:
    """Paths of the maps of a noise.json: ``noise_dark.tif`` and so on, beside it."""
    try:
        _as_text(path.stem)
    except UnicodeDecodeError as error:
        raise NoiseFileError(
            f"cannot write {path}: its name is not UTF-8; choose another", source=str(path)
        ) from error
    return {name: path.with_name(f"{path.stem}_{name}.tif") for name in _NAMES}


def write_map_files(path: Path, maps: CorrectionMaps) -> dict[str, MapFile]:
    """Write the maps beside the noise.json ``path``; return their names and hashes."""
    planes: dict[str, NDArray[Any]] = {
        "dark": maps.dark_dn,
        "flat": maps.response,
        "defects": maps.defects,
    }
    written = {}
    for name, map_path in map_paths(path).items():
        buffer = BytesIO()
        tifffile.imwrite(
            buffer,
            planes[name],
            photometric="minisblack",
            description=_TITLES[name],
            metadata=None,
        )
        data = buffer.getvalue()
        try:
            write_shared(map_path, data)
        except OSError as error:
            raise NoiseFileError(
                f"cannot write {map_path}: {error.strerror}", source=str(map_path)
            ) from error
        written[name] = MapFile(
            file=_as_text(map_path.name), sha256=hashlib.sha256(data).hexdigest()
        )
    return written


def read_map_files(path: Path, noise: NoiseCalibration) -> CorrectionMaps:
    """Read the maps beside the noise.json ``path``."""
    if noise.maps is None:
        raise NoiseFileError(
            f"{path} lists no maps; write it with standoff noise from dark and flat captures",
            source=str(path),
            key="maps",
        )
    planes = {name: _plane(path, name, noise.maps.get(name)) for name in _NAMES}
    try:
        return CorrectionMaps(
            dark_dn=planes["dark"].astype(np.float32, copy=False),
            response=planes["flat"].astype(np.float32, copy=False),
            defects=planes["defects"].astype(np.uint8, copy=False),
            black_level_dn=noise.black_level_dn,
        )
    except ValueError as error:
        raise NoiseFileError(f"{path}: {error}", source=str(path), key="maps") from error


def _as_text(name: str) -> str:
    """The name of a file as text, whatever encoding the system takes its names for."""
    return os.fsencode(name).decode("utf-8")


def _plane(path: Path, name: str, entry: MapFile | None) -> NDArray[Any]:
    key = f"maps.{name}"
    file = "" if entry is None else entry.file
    if entry is None or file in ("", ".", "..") or Path(file).name != file or "\0" in file:
        raise NoiseFileError(
            f"{path}: {key} does not name a file beside it", source=str(path), key=key
        )
    map_path = path.with_name(os.fsdecode(entry.file.encode("utf-8")))
    try:
        data = read_regular_file(map_path, LARGEST_IMAGE_BYTES)
    except OSError as error:
        raise NoiseFileError(
            f"cannot read {map_path}, a map of {path.name}: {error.strerror}; keep them together",
            source=str(map_path),
            key=key,
        ) from error
    if hashlib.sha256(data).hexdigest() != entry.sha256:
        raise NoiseFileError(
            f"{map_path} is not the map that {path.name} was written with; "
            "run standoff noise again",
            source=str(map_path),
            key=f"{key}.sha256",
        )
    try:
        return read_tiff(data, first_alone=True).images[0]
    except TiffDamageError as error:
        raise NoiseFileError(
            f"{map_path}: not a readable TIFF file: {error}", source=str(map_path), key=key
        ) from error
