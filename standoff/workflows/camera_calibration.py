"""Calibrates a camera's PSF: from edges, from the edges of a scene, or from two distances."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from acquisition.session import Session
from calibration.choices import CalibrationMethod, TargetChoice
from calibration.edges import EdgeImage, EdgeSelection, Region
from calibration.errors import CalibrationError
from calibration.psf import (
    PsfCalibration,
    PsfOrigin,
    calibrate_mosaic,
    calibrate_psf,
    capture_images,
    scene_records,
)
from standoff.photographs import Inputs
from standoff.terminal import note, progress_bar
from standoff.workflows.edge_sources import (
    EdgeSources,
    Reading,
    from_files,
    from_session,
    origin_of,
    taken_with,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRequest:
    """Photographs or a session, how to read them, and how to get the PSF from them.

    ``region`` returns the part of an image to use, None for all of it; ``zoom`` is the distance
    ratio of two photographs, if it is known; ``target`` whether the scene beside an edge target is
    told from it. ``inputs`` reads the photographs.
    """

    images: tuple[Path, ...]
    session: Path | None
    reading: Reading
    method: CalibrationMethod
    inputs: Inputs
    region: Callable[[EdgeImage], Region | None]
    zoom: float | None = None
    target: TargetChoice = "auto"


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedCamera:
    """The PSF, the camera it belongs to, and the photographs of the edge target, if any."""

    calibration: PsfCalibration
    origin: PsfOrigin
    edges: EdgeSources | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scenes:
    """Photographs by scene, each with the nearest first, and what is known about the camera."""

    series: tuple[tuple[EdgeImage, ...], ...]
    origin: PsfOrigin

    @property
    def images(self) -> list[EdgeImage]:
        """All photographs, scene by scene."""
        return [image for scene in self.series for image in scene]

    @property
    def pairs(self) -> int:
        """Number of pairs of a scene's nearest photograph and a further one."""
        return sum(len(scene) - 1 for scene in self.series)


def calibrate_camera(request: CalibrationRequest) -> CalibratedCamera:
    """Measure the PSF, with a progress bar on stderr.

    Raises
    ------
    CalibrationError
        If the photographs do not determine it.
    """
    calibrate = _METHODS[request.method]
    try:
        return calibrate(request)
    except ValueError as error:
        raise CalibrationError(str(error)) from error


def _from_edges(request: CalibrationRequest) -> CalibratedCamera:
    assert request.method == "all-angles" or request.method == "paper"
    sources = (
        from_files(request.images, request.reading, request.inputs)
        if request.session is None
        else from_session(_session(request), request.reading)
    )
    reading = sources.reading
    selection = EdgeSelection(region=request.region, target=request.target)
    with progress_bar("measuring edges", sources.count) as bar:
        if reading.pattern is None:
            calibration = calibrate_psf(
                sources.images,
                method=request.method,
                selection=selection,
                progress=bar.advance_to,
            )
        else:
            calibration = calibrate_mosaic(
                sources.images,
                reading.pattern,
                reading.channel,
                method=request.method,
                selection=selection,
                progress=bar.advance_to,
            )
    return CalibratedCamera(
        calibration=calibration,
        origin=taken_with(sources),
        edges=sources,
    )


def _from_scene(request: CalibrationRequest) -> CalibratedCamera:
    from calibration.blind import calibrate_from_scene  # with what aligns photographs

    scenes = _scenes(request)
    with progress_bar("measuring edges", len(scenes.images)) as bar:
        calibration = calibrate_from_scene(
            scenes.images, region=request.region, progress=bar.advance_to
        )
    return CalibratedCamera(calibration=calibration, origin=scenes.origin)


def _from_distances(request: CalibrationRequest) -> CalibratedCamera:
    from calibration.blind import calibrate_from_distances  # with what aligns photographs

    scenes = _scenes(request)
    if any(scene[0].noise is None for scene in scenes.series):
        note("the noise of the photographs is unknown and counts as blur; give --noise")
    with progress_bar("comparing distances", scenes.pairs) as bar:
        calibration = calibrate_from_distances(
            scenes.series, zoom=request.zoom, region=request.region, progress=bar.advance_to
        )
    return CalibratedCamera(calibration=calibration, origin=scenes.origin)


def _scenes(request: CalibrationRequest) -> _Scenes:
    reading = request.reading
    if request.session is None:
        sources = from_files(request.images, reading, request.inputs)
        if sources.reading.pattern is not None:
            raise CalibrationError(
                "of raw mosaics the edges alone are measured: --method all-angles or paper"
            )
        return _Scenes(series=(tuple(sources.images),), origin=sources.origin)
    session = _session(request)
    records = scene_records(session)
    series = tuple(
        tuple(
            capture_images(
                session, scene, correction=reading.correction, frame_noise=reading.frame_noise
            )
        )
        for scene in records
    )
    origin = origin_of(session, [record for scene in records for record in scene])
    return _Scenes(series=series, origin=origin)


def _session(request: CalibrationRequest) -> Session:
    assert request.session is not None
    session = Session(request.session)
    request.inputs.add_session(session)
    return session


_METHODS: dict[CalibrationMethod, Callable[[CalibrationRequest], CalibratedCamera]] = {
    "all-angles": _from_edges,
    "paper": _from_edges,
    "single-image": _from_scene,
    "two-distance": _from_distances,
}
