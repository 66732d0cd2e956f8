"""Reading and writing psf.json, noise.json, geometry.json, H.json and depth maps; no other does."""

from acquisition.files import written_together
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
from calibration.scene_depth import scene_depth
from simulation import SceneDepth
from simulation.arguments import FilePath, checked, output_path, path_of


@checked
def write_psf(path: FilePath, psf: PsfCalibration) -> None:
    """Write a psf.json, whole or not at all.

    Parameters
    ----------
    path
        Path of the file to write.
    psf
        As ``calibrate_psf`` returns it.

    Raises
    ------
    TypeError
        If the arguments are not a path and a calibration.
    PsfFileError
        If the file cannot be written.

    Examples
    --------
    >>> standoff.write_psf("edge-psf.json", standoff.calibrate_psf("vertical.tif"))
    """
    write_document(output_path(path, "path", {".json"}), psf, PsfFileError)


@checked
def read_psf(path: FilePath) -> PsfCalibration:
    """Read a psf.json.

    Parameters
    ----------
    path
        Path of the file, as ``write_psf`` and ``standoff calibrate`` write it.

    Returns
    -------
    PsfCalibration
        The contents of the file; functions with ``psf=`` take it, but ``validate``.

    Raises
    ------
    PsfFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> round(standoff.read_psf("psf.json").sigma_x_px, 2)
    0.76
    """
    return read_document(path, PsfCalibration, PsfFileError, "write it with standoff calibrate")


@checked
def write_geometry(path: FilePath, geometry: GeometryCalibration) -> None:
    """Write a geometry.json, whole or not at all.

    Parameters
    ----------
    path
        Path of the file to write.
    geometry
        As ``calibrate_geometry`` returns it.

    Raises
    ------
    GeometryFileError
        If the file cannot be written.

    Examples
    --------
    >>> standoff.write_geometry("board.json", standoff.calibrate_geometry("board"))
    """
    write_document(output_path(path, "path", {".json"}), geometry, GeometryFileError)


@checked
def read_geometry(path: FilePath) -> GeometryCalibration:
    """Read a geometry.json.

    Parameters
    ----------
    path
        Path of the file, as ``write_geometry`` and ``standoff geometry`` write it.

    Returns
    -------
    GeometryCalibration
        The contents of the file.

    Raises
    ------
    GeometryFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> geometry = standoff.read_geometry("geometry.json")
    >>> round(geometry.zoom(160, 300), 3)
    1.812
    """
    return read_document(
        path, GeometryCalibration, GeometryFileError, "write it with standoff geometry"
    )


@checked
def write_homography(path: FilePath, homography: Homography) -> None:
    """Write an H.json, whole or not at all.

    Parameters
    ----------
    path
        Path of the file to write.
    homography
        The homography, with the follow-up's size and the distortion.

    Raises
    ------
    HomographyFileError
        If the file cannot be written.

    Examples
    --------
    >>> pose = standoff.Homography(matrix=[[2, 0, 0], [0, 2, 0], [0, 0, 1]], size=(160, 120))
    >>> standoff.write_homography("half.json", pose)
    """
    write_document(path, homography, HomographyFileError)


@checked
def read_homography(path: FilePath) -> Homography:
    """Read an H.json.

    Parameters
    ----------
    path
        Path of the file, as ``write_homography`` writes it.

    Returns
    -------
    Homography
        The homography; ``simulate``, ``simulate_pose`` and ``judge_homography`` take it.

    Raises
    ------
    HomographyFileError
        If it cannot be read, is of another schema, or its matrix, size or distortion is not valid.

    Examples
    --------
    >>> standoff.read_homography("H.json").size
    (320, 240)
    """
    return read_document(path, Homography, HomographyFileError, "give an H.json")


@checked
def read_depth(
    path: FilePath, *, focal_length_px: float | None = None, plane_depth: float | None = None
) -> SceneDepth:
    """Read the depth of a photograph's scene.

    Parameters
    ----------
    path
        A map of the photograph's size, TIFF or PNG of one channel: distances along the optical
        axis in any unit, 0 or NaN where they are not known. Or a list of planes, JSON.
    focal_length_px, plane_depth
        As `SceneDepth` has them.

    Returns
    -------
    SceneDepth
        The depth; ``simulate`` takes it.

    Raises
    ------
    DepthFileError
        If it cannot be read, has several channels, or holds no depth.

    Examples
    --------
    >>> scene = standoff.read_depth("depth.tif")
    >>> far = standoff.simulate("before.tif", zoom=1.5, depth=scene, psf="psf.json")
    >>> far.mask_fractions["hidden_fraction"] > 0
    True
    """
    return scene_depth(path_of(path, "path"), focal_length_px, plane_depth)


@checked
def read_noise(path: FilePath) -> NoiseCalibration:
    """Read a noise.json.

    Parameters
    ----------
    path
        Path of the file, as ``write_noise`` and ``standoff noise`` write it.

    Returns
    -------
    NoiseCalibration
        The contents of the file; functions with ``noise=`` take its ``capture_noise``.

    Raises
    ------
    NoiseFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> round(standoff.read_noise("noise.json").read_noise_e)
    12
    """
    return read_document(path, NoiseCalibration, NoiseFileError, "give a noise.json")


@checked
def write_noise(path: FilePath, noise: NoiseMeasurement) -> NoiseCalibration:
    """Write a noise.json and its maps beside it, all or none; return the document.

    Parameters
    ----------
    path
        Path of the noise.json to write.
    noise
        As ``measure_noise`` returns it.

    Returns
    -------
    NoiseCalibration
        The document, with the names of the maps.

    Raises
    ------
    NoiseFileError, ApplicationError
        If a file cannot be written.

    Examples
    --------
    >>> document = standoff.write_noise("flats.json", standoff.measure_noise("flats"))
    >>> round(document.read_noise_e)
    12
    """
    out = output_path(path, "path", {".json"})
    with written_together(out) as folder:
        return _write_noise_files(folder / out.name, noise)


def _write_noise_files(path: FilePath, noise: NoiseMeasurement) -> NoiseCalibration:
    """Write the maps, then noise.json, each whole or not at all; return the document."""
    written = noise.calibration.model_copy(
        update={"maps": write_map_files(path_of(path, "path"), noise.maps)}
    )
    write_document(path, written, NoiseFileError)
    return written


@checked
def read_correction(path: FilePath) -> CorrectionMaps:
    """Read the dark, flat and defect maps of a noise.json.

    Parameters
    ----------
    path
        Path of the noise.json; the maps lie beside it.

    Returns
    -------
    CorrectionMaps
        The maps; functions with ``correct=`` take them.

    Raises
    ------
    NoiseFileError
        If the file or a map cannot be read, or a map is not the one it was written with.

    Examples
    --------
    >>> standoff.read_correction("noise.json").dark_dn.shape
    (240, 320)
    """
    return read_map_files(path_of(path, "path"), read_noise(path))
