"""The camera's PSF from photographs of edges, and its file."""

from collections.abc import Callable, Iterable, Iterator

from acquisition import Session as Session
from calibration.edges import (
    EdgeImage,
    EdgeMeasurement,
    Method,
    Region,
    measure_edges as measured_edges,
)
from calibration.files import read_psf as read_psf_file, write_psf as write_psf_file
from calibration.psf import PsfCalibration, calibrate_psf as psf_of_images, edge_images
from simulation import GaussianPsf as GaussianPsf
from standoff.library.inputs import FilePath, ImageLike, listed_images, path_of, photograph
from standoff.workflows import Reading, edge_image


def calibrate_psf(
    images: ImageLike | Iterable[ImageLike] | Session,
    *,
    method: Method = "all-angles",
    region: Region | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the camera's PSF from photographs of straight edges.

    Parameters
    ----------
    images
        Arrays or files, linear in light; or a session, whose edge captures are used.
    method
        ``all-angles`` by maximum likelihood on the raw pixels, or ``paper``: medians over
        vertical and horizontal edges.
    region
        Part of each photograph to use; None for all of it.
    progress
        Called with the number of photographs done.

    Returns
    -------
    PsfCalibration
        Total and optical PSF with standard errors; None for values the edges do not determine.

    Raises
    ------
    TypeError
        If an image is neither an array nor a path.
    NoEdgeError
        If no edge is found, or none is usable; the message says why.
    """
    return psf_of_images(
        _edge_images(images), method=method, region=lambda _: region, progress=progress
    )


def measure_edges(
    image: ImageLike, *, method: Method = "all-angles", region: Region | None = None
) -> tuple[EdgeMeasurement, ...]:
    """Find the straight edges of one photograph and measure the blur across each.

    Parameters
    ----------
    image
        An array or a file, linear in light.
    method, region
        As in ``calibrate_psf``.

    Returns
    -------
    tuple of EdgeMeasurement
        Edges that are not used are included, with a flag that says why.

    Raises
    ------
    TypeError
        If the image is neither an array nor a path.
    """
    source = edge_image(photograph(image), Reading())
    if region is not None:
        source.refuse_beyond_frame(region)
    return tuple(measured_edges(source, region, method))


def read_psf(path: FilePath) -> PsfCalibration:
    """Read a psf.json.

    Raises
    ------
    TypeError
        If it is not a path.
    PsfFileError
        If the file cannot be read, or is not a psf.json.
    """
    return read_psf_file(path_of(path, "path"))


def write_psf(path: FilePath, psf: PsfCalibration) -> None:
    """Write a psf.json, whole or not at all.

    Raises
    ------
    TypeError
        If the arguments are not a path and a calibration.
    PsfFileError
        If the file cannot be written.
    """
    if not isinstance(psf, PsfCalibration):
        raise TypeError(f"psf: expected a PSF calibration, got {type(psf).__name__}")
    write_psf_file(path_of(path, "path"), psf)


def _edge_images(images: ImageLike | Iterable[ImageLike] | Session) -> Iterator[EdgeImage]:
    if isinstance(images, Session):
        yield from edge_images(images)
        return
    for number, image in enumerate(listed_images(images)):
        yield edge_image(photograph(image, f"images[{number}]"), Reading())
