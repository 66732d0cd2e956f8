"""Reads and writes psf.json, noise.json and geometry.json, reads H.json: nothing else does."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from acquisition.session import atomic_write
from acquisition.untrusted import parse_json
from calibration.errors import (
    CalibrationError,
    DocumentError,
    GeometryFileError,
    HomographyFileError,
    NoiseFileError,
    PsfFileError,
)
from calibration.geometry import (
    GEOMETRY_SCHEMA,
    GeometryCalibration,
    StoredGeometry,
    geometry_document,
)
from calibration.noise import (
    NOISE_SCHEMA,
    CorrectionMaps,
    NoiseCalibration,
    NoiseMeasurement,
    read_map_files,
    write_map_files,
)
from calibration.psf import PSF_SCHEMA, PsfCalibration, PsfOrigin

__all__ = [
    "GEOMETRY_SCHEMA",
    "HOMOGRAPHY_SCHEMA",
    "NOISE_SCHEMA",
    "PSF_SCHEMA",
    "PsfOrigin",
    "StoredGeometry",
    "StoredHomography",
    "geometry_document",
    "json_object",
    "read_correction",
    "read_document",
    "read_geometry",
    "read_homography",
    "read_noise",
    "read_psf",
    "write_document",
    "write_geometry",
    "write_noise",
    "write_psf",
]

HOMOGRAPHY_SCHEMA = "standoff.homography/1"

Document = TypeVar("Document", bound=BaseModel)


def json_object(document: BaseModel) -> dict[str, Any]:
    """Return the content of a document's file as plain lists, numbers and text."""
    return document.model_dump(mode="json", by_alias=True)


def write_document(path: Path, document: BaseModel, failure: type[DocumentError]) -> None:
    """Write a document as JSON, whole or not at all.

    Raises
    ------
    DocumentError
        As ``failure``, if the file cannot be written.
    ValueError
        If a number is infinite or NaN.
    """
    text = json.dumps(json_object(document), indent=1, allow_nan=False) + "\n"
    try:
        atomic_write(path, text.encode("utf-8"))
    except OSError as error:
        raise failure(f"cannot write {path}: {error.strerror}", source=str(path)) from error


def read_document(
    path: Path, model: type[Document], failure: type[DocumentError], remedy: str
) -> Document:
    """Read a JSON file into the model of its schema.

    Parameters
    ----------
    path
        The file.
    model
        Names its schema as the default of the field ``schema_name``, whose alias is ``schema``.
    failure
        The error to raise.
    remedy
        What to do about a file of another schema.

    Raises
    ------
    DocumentError
        As ``failure``, if the file cannot be read, is of another schema or does not fit the model.
    """
    source = str(path)
    schema = model.model_fields["schema_name"].default
    try:
        document = parse_json(path.read_bytes())
    except OSError as error:
        raise failure(f"cannot read {path}: {error.strerror}", source=source) from error
    except ValueError as error:
        name = schema.removeprefix("standoff.").partition("/")[0]
        raise failure(f"{path}: not a {name}.json: {error}", source=source) from error
    found = document.get("schema") if isinstance(document, dict) else None
    if found != schema:
        raise failure(
            f"{path}: schema is {found!r}, expected {schema!r}; {remedy}",
            source=source,
            key="schema",
        )
    try:
        return model.model_validate(document)
    except ValidationError as error:
        fault = error.errors()[0]
        key = ".".join(str(part) for part in fault["loc"]) or None
        problem = fault["msg"].removeprefix("Value error, ")
        where = source if key is None else f"{source}: {key}"
        raise failure(f"{where}: {problem}", source=source, key=key) from error


def write_psf(path: Path, calibration: PsfCalibration) -> None:
    """Write psf.json, whole or not at all.

    Raises
    ------
    PsfFileError
        If the file cannot be written.
    """
    write_document(path, calibration, PsfFileError)


def read_psf(path: Path) -> PsfCalibration:
    """Read a psf.json.

    Raises
    ------
    PsfFileError
        If it cannot be read, is of another schema or holds values that are not numbers.
    """
    return read_document(path, PsfCalibration, PsfFileError, "write it with standoff calibrate")


def write_geometry(path: Path, geometry: GeometryCalibration) -> None:
    """Write geometry.json, whole or not at all.

    Raises
    ------
    GeometryFileError
        If the file cannot be written.
    """
    text = json.dumps(geometry_document(geometry), indent=1, allow_nan=False) + "\n"
    try:
        atomic_write(path, text.encode("utf-8"))
    except OSError as error:
        raise GeometryFileError(f"cannot write {path}: {error.strerror}") from error


def read_geometry(path: Path) -> StoredGeometry:
    """Read a geometry.json.

    Raises
    ------
    GeometryFileError
        If it cannot be read, is of another schema or lacks a value.
    """
    document = _document(
        path, GEOMETRY_SCHEMA, GeometryFileError, "write it with standoff geometry"
    )
    try:
        return StoredGeometry.model_validate(document)
    except ValidationError as error:
        raise GeometryFileError(f"{path}: {_first_fault(error.errors())}") from error


def read_noise(path: Path) -> NoiseCalibration:
    """Read a noise.json.

    Raises
    ------
    NoiseFileError
        If it cannot be read, is of another schema, or lacks a value.
    """
    return read_document(path, NoiseCalibration, NoiseFileError, "name a noise.json")


def write_noise(path: Path, noise: NoiseMeasurement) -> NoiseCalibration:
    """Write the maps, then noise.json, each whole or not at all; return what it holds.

    Raises
    ------
    NoiseFileError
        If a file cannot be written.
    """
    written = noise.calibration.model_copy(update={"maps": write_map_files(path, noise.maps)})
    write_document(path, written, NoiseFileError)
    return written


def read_correction(path: Path) -> CorrectionMaps:
    """Read the dark, flat and defect maps of a noise.json.

    Raises
    ------
    NoiseFileError
        If it or a map cannot be read, or a map is not the one it was written with.
    """
    return read_map_files(path, read_noise(path))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredHomography:
    """What an H.json holds.

    ``matrix``, shape (3, 3), takes follow-up pixel centres (x, y, 1) to reference pixel centres;
    ``width_px`` and ``height_px`` are the follow-up's. With a radial distortion the matrix
    is that of ideal pixels.
    """

    matrix: NDArray[np.float64]
    width_px: int
    height_px: int
    distortion_k1: float = 0.0


def read_homography(path: Path) -> StoredHomography:
    """Read an H.json.

    Raises
    ------
    HomographyFileError
        If it cannot be read, is of another schema, or its matrix, size or distortion is none.
    """
    document = _document(path, HOMOGRAPHY_SCHEMA, HomographyFileError, "name an H.json")
    matrix, size = document.get("matrix"), document.get("size")
    try:
        values = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise HomographyFileError(f"{path}: matrix is not 3 x 3 numbers") from error
    if values.shape != (3, 3) or not np.all(np.isfinite(values)):
        raise HomographyFileError(f"{path}: matrix is not 3 x 3 finite numbers")
    distortion_k1 = document.get("distortion_k1", 0.0)
    is_number = isinstance(distortion_k1, int | float) and not isinstance(distortion_k1, bool)
    if not (is_number and abs(distortion_k1) < 1):
        raise HomographyFileError(
            f"{path}: distortion_k1 is {distortion_k1!r}, expected a number between -1 and 1"
        )
    match size:
        case [int(width), int(height)] if width > 0 and height > 0:
            return StoredHomography(
                matrix=values,
                width_px=width,
                height_px=height,
                distortion_k1=float(distortion_k1),
            )
    raise HomographyFileError(f"{path}: size is {size!r}, expected [width, height] in px")


def _document(
    path: Path, schema: str, failure: type[CalibrationError], remedy: str
) -> dict[str, Any]:
    """Read a JSON object and check its schema."""
    try:
        document = parse_json(path.read_bytes())
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
