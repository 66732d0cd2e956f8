"""Reading and writing psf.json, noise.json, geometry.json and H.json; no other module does it."""

import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from acquisition.session import atomic_write
from acquisition.untrusted import parse_json
from calibration.errors import (
    DocumentError,
    GeometryFileError,
    HomographyFileError,
    NoiseFileError,
    PsfFileError,
)
from calibration.geometry import GEOMETRY_SCHEMA, GeometryCalibration
from calibration.noise import (
    NOISE_SCHEMA,
    CorrectionMaps,
    NoiseCalibration,
    NoiseMeasurement,
    read_map_files,
    write_map_files,
)
from calibration.psf import PSF_SCHEMA, PsfCalibration, PsfOrigin
from calibration.registration import HOMOGRAPHY_SCHEMA, Homography

__all__ = [
    "GEOMETRY_SCHEMA",
    "HOMOGRAPHY_SCHEMA",
    "NOISE_SCHEMA",
    "PSF_SCHEMA",
    "PsfOrigin",
    "json_object",
    "read_correction",
    "read_document",
    "read_geometry",
    "read_homography",
    "read_noise",
    "read_psf",
    "write_document",
    "write_geometry",
    "write_homography",
    "write_noise",
    "write_psf",
]

Document = TypeVar("Document", bound=BaseModel)


def json_object(document: BaseModel) -> dict[str, Any]:
    """Return a document as it is written to its file: plain lists, numbers and strings."""
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
        Its field ``schema_name``, with the alias ``schema``, has the name of the schema as default.
    failure
        The error to raise.
    remedy
        What to do about a file with another schema.

    Raises
    ------
    DocumentError
        As ``failure``, if the file cannot be read, has another schema or does not fit the model.
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
        If it cannot be read, has another schema or contains values that are not numbers.
    """
    return read_document(path, PsfCalibration, PsfFileError, "write it with standoff calibrate")


def write_geometry(path: Path, geometry: GeometryCalibration) -> None:
    """Write geometry.json, whole or not at all.

    Raises
    ------
    GeometryFileError
        If the file cannot be written.
    """
    write_document(path, geometry, GeometryFileError)


def read_geometry(path: Path) -> GeometryCalibration:
    """Read a geometry.json.

    Raises
    ------
    GeometryFileError
        If it cannot be read, has another schema or lacks a value.
    """
    return read_document(
        path, GeometryCalibration, GeometryFileError, "write it with standoff geometry"
    )


def write_homography(path: Path, homography: Homography) -> None:
    """Write an H.json, whole or not at all.

    Raises
    ------
    HomographyFileError
        If the file cannot be written.
    """
    write_document(path, homography, HomographyFileError)


def read_homography(path: Path) -> Homography:
    """Read an H.json.

    Raises
    ------
    HomographyFileError
        If it cannot be read, has another schema, or its matrix, size or distortion is not valid.
    """
    return read_document(path, Homography, HomographyFileError, "give an H.json")


def read_noise(path: Path) -> NoiseCalibration:
    """Read a noise.json.

    Raises
    ------
    NoiseFileError
        If it cannot be read, has another schema or lacks a value.
    """
    return read_document(path, NoiseCalibration, NoiseFileError, "give a noise.json")


def write_noise(path: Path, noise: NoiseMeasurement) -> NoiseCalibration:
    """Write the maps, then noise.json, each whole or not at all; return the document written.

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
        If the file or a map cannot be read, or a map is not the one it was written with.
    """
    return read_map_files(path, read_noise(path))
