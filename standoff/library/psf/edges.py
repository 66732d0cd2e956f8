"""The edges of one photograph, and the file of a PSF."""

from acquisition import Session as Session
from acquisition.photographs import ReadOptions
from calibration.edges import EdgeMeasurement, Method, Region, measure_edges as measured_edges
from calibration.files import read_psf as read_psf, write_psf as write_psf_file
from calibration.psf import PsfCalibration
from calibration.sharpness import with_sharpness
from simulation import GaussianPsf as GaussianPsf, TabulatedPsf as TabulatedPsf
from simulation.arguments import ArgumentError, checked
from standoff.library.files import write_file
from standoff.library.inputs import (
    FilePath,
    ImageLike,
    output_path,
    photograph,
    with_white_level,
)
from standoff.library.psf.edge_sources import Reading, edge_image


@checked
def measure_edges(
    image: ImageLike,
    *,
    method: Method = "all-angles",
    region: Region | None = None,
    white_level: float | None = None,
    reading: ReadOptions | None = None,
) -> tuple[EdgeMeasurement, ...]:
    """Find the straight edges of one photograph and measure the blur across each.

    Parameters
    ----------
    image
        An array or a file, linear in light.
    method, region, white_level, reading
        As in ``calibrate_psf``.

    Returns
    -------
    tuple of EdgeMeasurement
        Edges that are not used are included, with a flag that says why.

    Raises
    ------
    TypeError
        If the image is neither an array nor a path.

    Examples
    --------
    >>> [round(edge.sigma_px, 2) for edge in standoff.measure_edges("vertical.tif")]
    [0.94, 0.93]
    """
    source = edge_image(
        photograph(image, options=with_white_level(reading, white_level)), Reading()
    )
    if region is not None:
        try:
            source.refuse_beyond_frame(region)
        except ValueError as error:
            raise ArgumentError(str(error), argument="region") from error
    return tuple(with_sharpness(measured_edges(source, region, method), source))


@checked
def write_psf(path: FilePath, psf: PsfCalibration) -> None:
    """Write a psf.json, whole or not at all.

    Parameters
    ----------
    path
        Of the file.
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
    write_psf_file(output_path(path, "path", {".json"}), psf)


@checked
def write_edge_table(path: FilePath, psf: PsfCalibration) -> None:
    """Write the edges of a calibration as CSV, a line an edge, with their SFR.

    Parameters
    ----------
    path
        Of the file.
    psf
        A calibration with its edges.

    Raises
    ------
    ApplicationError
        If the file cannot be written.

    Examples
    --------
    >>> standoff.write_edge_table("edges.csv", standoff.calibrate_psf("vertical.tif"))
    """
    from analysis.reports import edge_csv  # loads what plots

    write_file(output_path(path, "path", {".csv"}), edge_csv(psf).encode("utf-8"))
