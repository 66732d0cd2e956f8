"""Reads and writes psf.json, reads noise.json and H.json: nothing else here touches them."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from acquisition.atomic_write import atomic_write
from calibration.covariance_fit import Estimate
from calibration.errors import CalibrationError, HomographyFileError, NoiseFileError, PsfFileError
from calibration.psf_calibration import EdgeMeasurement, PsfCalibration
from simulation.capture_noise import CaptureNoise
from simulation.field import PsfField
from simulation.psf import GaussianPsf

__all__ = [
    "HOMOGRAPHY_SCHEMA",
    "NOISE_SCHEMA",
    "PSF_SCHEMA",
    "StoredEdge",
    "StoredField",
    "StoredHomography",
    "StoredPsf",
    "psf_document",
    "read_homography",
    "read_noise",
    "read_psf",
    "write_psf",
]

PSF_SCHEMA = "standoff.psf/1"
NOISE_SCHEMA = "standoff.noise/1"
HOMOGRAPHY_SCHEMA = "standoff.homography/1"

_Matrix = list[list[float]]


class StoredEdge(BaseModel):
    """One edge of a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    image: str
    capture: int | None
    height_mm: float | None
    x_px: float
    y_px: float
    angle_deg: float
    orientation: Literal["vertical", "horizontal", "diagonal"]
    length_px: float
    snr: float | None
    sigma_px: float
    sigma_err_px: float
    optical_sigma_px: float | None
    optical_sigma_err_px: float | None
    mtf50_cy_per_px: float
    chi2_reduced: float | None
    flags: list[str]


class StoredField(BaseModel):
    """The PSF over the frame, in a psf.json: what ``PsfField`` takes, rows xx, xy and yy.

    The coefficients without prefix are those of the total covariance.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    width_px: int
    height_px: int
    coefficients_px2: _Matrix
    optical_coefficients_px2: _Matrix | None = None


class StoredPsf(BaseModel):
    """What a psf.json holds; None for what its edges did not determine.

    sigma without prefix is the total PSF. Only the total values need to be there.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    sigma_x_px: float | None = None
    sigma_y_px: float | None = None
    rho: float | None = None
    covariance_px2: _Matrix | None = None
    sigma_x_err_px: float | None = None
    sigma_y_err_px: float | None = None
    rho_err: float | None = None
    optical_sigma_x_px: float | None = None
    optical_sigma_y_px: float | None = None
    optical_sigma_x_err_px: float | None = None
    optical_sigma_y_err_px: float | None = None
    optical_rho: float | None = None
    optical_rho_err: float | None = None
    optical_covariance_px2: _Matrix | None = None
    intervals_95: dict[str, tuple[float, float]] = {}
    field: StoredField | None = None
    method: str | None = None
    edges: list[StoredEdge] = []

    def total_psf(self, source: str) -> GaussianPsf:
        """Return the total PSF; a correlation that is not given is taken as none.

        Raises
        ------
        PsfFileError
            If a width is null; the message names ``source`` and the width.
        """
        for name, edges in (("sigma_x_px", "vertical"), ("sigma_y_px", "horizontal")):
            if getattr(self, name) is None:
                raise PsfFileError(
                    f"{source}: {name} is null: its edges do not determine it; "
                    f"calibrate with {edges} edges as well"
                )
        try:
            return GaussianPsf(
                sigma_x_px=float(self.sigma_x_px or 0.0),
                sigma_y_px=float(self.sigma_y_px or 0.0),
                rho=self.rho or 0.0,
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: {error}") from error

    def total_field(self, source: str) -> PsfField | None:
        """Return the total PSF over the frame, None where the file has none.

        Raises
        ------
        PsfFileError
            If its coefficients make no PSF; the message names ``source``.
        """
        if self.field is None:
            return None
        try:
            return PsfField(
                width_px=self.field.width_px,
                height_px=self.field.height_px,
                coefficients_px2=np.array(self.field.coefficients_px2, dtype=np.float64),
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: field: {error}") from error


def psf_document(calibration: PsfCalibration) -> dict[str, Any]:
    """Return the content of psf.json as plain lists and numbers."""
    widths = {
        name: getattr(calibration, name)
        for name in (
            "sigma_x_px",
            "sigma_y_px",
            "rho",
            "optical_sigma_x_px",
            "optical_sigma_y_px",
            "optical_rho",
        )
    }
    document: dict[str, Any] = {"schema": PSF_SCHEMA}
    for name, estimate in widths.items():
        document[name] = _value(estimate)
        error_name = name.replace("_px", "_err_px") if name.endswith("_px") else f"{name}_err"
        document[error_name] = estimate.err if estimate else None
    for name in ("covariance_px2", "optical_covariance_px2"):
        matrix = getattr(calibration, name)
        document[name] = None if matrix is None else np.asarray(matrix).tolist()
    document["intervals_95"] = {n: [e.low, e.high] for n, e in widths.items() if e is not None}
    document["field"] = None
    document["method"] = calibration.method
    document["edges"] = [_edge_document(edge) for edge in calibration.edges]
    return document


def write_psf(path: Path, calibration: PsfCalibration) -> None:
    """Write psf.json, whole or not at all.

    Raises
    ------
    PsfFileError
        If the file cannot be written.
    """
    text = json.dumps(psf_document(calibration), indent=1, allow_nan=False) + "\n"
    try:
        atomic_write(path, text.encode("utf-8"))
    except OSError as error:
        raise PsfFileError(f"cannot write {path}: {error.strerror}") from error


def read_psf(path: Path) -> StoredPsf:
    """Read a psf.json.

    Raises
    ------
    PsfFileError
        If it cannot be read, is of another schema or holds values that are not numbers.
    """
    document = _document(path, PSF_SCHEMA, PsfFileError, "write it with standoff calibrate")
    try:
        return StoredPsf.model_validate(document)
    except ValidationError as error:
        raise PsfFileError(f"{path}: {_first_fault(error.errors())}") from error


def read_noise(path: Path) -> CaptureNoise:
    """Read the noise model of a noise.json.

    Raises
    ------
    NoiseFileError
        If it cannot be read, is of another schema, or lacks a value.
    """
    document = _document(path, NOISE_SCHEMA, NoiseFileError, "name a noise.json")
    values = {}
    for name in ("gain_e_per_dn", "read_noise_e", "black_level_dn", "frames_averaged"):
        value = document.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise NoiseFileError(f"{path}: {name} is {value!r}, expected a number")
        values[name] = value
    try:
        return CaptureNoise(
            gain_e_per_dn=values["gain_e_per_dn"],
            read_noise_e=values["read_noise_e"],
            black_level_dn=values["black_level_dn"],
            frames_averaged=_whole(values["frames_averaged"]),
        )
    except ValueError as error:
        raise NoiseFileError(f"{path}: {error}") from error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredHomography:
    """What an H.json holds.

    ``matrix``, shape (3, 3), takes follow-up pixel centres (x, y, 1) to reference pixel centres;
    ``width_px`` and ``height_px`` are the follow-up's.
    """

    matrix: NDArray[np.float64]
    width_px: int
    height_px: int


def read_homography(path: Path) -> StoredHomography:
    """Read an H.json.

    Raises
    ------
    HomographyFileError
        If it cannot be read, is of another schema, or its matrix or size is none.
    """
    document = _document(path, HOMOGRAPHY_SCHEMA, HomographyFileError, "name an H.json")
    matrix, size = document.get("matrix"), document.get("size")
    try:
        values = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise HomographyFileError(f"{path}: matrix is not 3 x 3 numbers") from error
    if values.shape != (3, 3) or not np.all(np.isfinite(values)):
        raise HomographyFileError(f"{path}: matrix is not 3 x 3 finite numbers")
    match size:
        case [int(width), int(height)] if width > 0 and height > 0:
            return StoredHomography(matrix=values, width_px=width, height_px=height)
    raise HomographyFileError(f"{path}: size is {size!r}, expected [width, height] in px")


def _whole(value: float) -> int:
    if value != int(value):
        raise ValueError(f"frames_averaged is {value}, expected a whole number")
    return int(value)


def _document(
    path: Path, schema: str, failure: type[CalibrationError], remedy: str
) -> dict[str, Any]:
    """Read a JSON object and check its schema."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise failure(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        name = schema.removeprefix("standoff.").partition("/")[0]
        raise failure(f"{path}: not a {name}.json: {error}") from error
    found = document.get("schema") if isinstance(document, dict) else None
    if found != schema:
        raise failure(f"{path}: schema is {found!r}, expected {schema!r}; {remedy}")
    return dict(document)


def _first_fault(faults: Sequence[Any]) -> str:
    place = ".".join(str(part) for part in faults[0]["loc"])
    return f"{place}: {faults[0]['msg']}"


def _value(estimate: Estimate | None) -> float | None:
    return estimate.value if estimate else None


def _edge_document(edge: EdgeMeasurement) -> dict[str, Any]:
    fit = edge.fit
    return {
        "image": edge.image,
        "capture": edge.capture,
        "height_mm": edge.height_mm,
        "x_px": fit.x_px,
        "y_px": fit.y_px,
        "angle_deg": fit.angle_deg,
        "orientation": edge.orientation,
        "length_px": fit.length_px,
        "snr": fit.snr if math.isfinite(fit.snr) else None,
        "sigma_px": fit.sigma_px,
        "sigma_err_px": fit.sigma_err_px,
        "optical_sigma_px": fit.optical_sigma_px,
        "optical_sigma_err_px": fit.optical_sigma_err_px,
        "mtf50_cy_per_px": edge.mtf50_cy_per_px,
        "chi2_reduced": fit.chi2_reduced,
        "flags": list(edge.flags),
    }
