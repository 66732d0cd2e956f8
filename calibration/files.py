"""Reading and writing psf.json, noise.json, geometry.json and H.json; no other module does it."""

from pathlib import Path

from calibration.documents import read_document, write_document
from calibration.errors import (
    GeometryFileError,
    HomographyFileError,
    NoiseFileError,
    PsfFileError,
)
from calibration.geometry import GeometryCalibration
from calibration.noise import (
    CorrectionMaps,
    NoiseCalibration,
    NoiseMeasurement,
    read_map_files,
    write_map_files,
)
from calibration.psf import PsfCalibration
from calibration.registration import Homography


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
