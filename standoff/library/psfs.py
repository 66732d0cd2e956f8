"""The camera's PSF from photographs of edges, and its file."""

from collections.abc import Callable, Iterable
from os import PathLike
from pathlib import Path

from acquisition import Session as Session
from calibration.choices import TargetChoice
from calibration.edges import (
    EdgeMeasurement,
    EdgeSelection,
    Method,
    Region,
    measure_edges as measured_edges,
)
from calibration.files import read_psf as read_psf_file, write_psf as write_psf_file
from calibration.psf import (
    PsfCalibration,
    calibrate_mosaic,
    calibrate_psf as psf_of_images,
    edge_images,
)
from calibration.sharpness import with_sharpness
from simulation import GaussianPsf as GaussianPsf
from standoff.library.inputs import FilePath, ImageLike, listed_images, path_of, photograph
from standoff.photographs import Inputs, Photograph
from standoff.workflows import Reading, edge_image


def calibrate_psf(
    images: ImageLike | Iterable[ImageLike] | Session,
    *,
    method: Method = "all-angles",
    region: Region | None = None,
    target: TargetChoice = "auto",
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the camera's PSF from photographs of straight edges.

    Parameters
    ----------
    images
        Arrays linear in light, or files; of camera raw files every colour is measured, and green
        is returned. Or a session, whose edge captures are used.
    method
        ``all-angles`` by maximum likelihood on the raw pixels, or ``paper``: medians over
        vertical and horizontal edges.
    region
        Part of each photograph to use; None for all of it.
    target
        With ``auto``, edges of the scene beside a target do not count, and are flagged
        ``beside_target``; with ``all``, every edge counts.
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
    selection = EdgeSelection(region=lambda _: region, target=target)
    if isinstance(images, Session):
        inputs = Inputs()
        inputs.add_session(images)
        found = psf_of_images(
            edge_images(images), method=method, selection=selection, progress=progress
        )
        return _with_provenance(found, inputs)
    inputs = Inputs()
    listed = listed_images(images)
    pattern = _read(listed[0], "images[0]", inputs).pattern
    sources = (
        edge_image(_read(image, f"images[{number}]", inputs), Reading(pattern=pattern))
        for number, image in enumerate(listed)
    )
    if pattern is None:
        found = psf_of_images(sources, method=method, selection=selection, progress=progress)
    else:
        found = calibrate_mosaic(
            sources, pattern, method=method, selection=selection, progress=progress
        )
    return _with_provenance(found, inputs)


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
    return tuple(with_sharpness(measured_edges(source, region, method), source))


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


def _read(image: ImageLike, name: str, inputs: Inputs) -> Photograph:
    if isinstance(image, str | PathLike):
        return inputs.photograph(Path(image))
    return photograph(image, name)


def _with_provenance(found: PsfCalibration, inputs: Inputs) -> PsfCalibration:
    return found.model_copy(update={"provenance": inputs.provenance("standoff.calibrate_psf")})
