"""``calibrate`` without an edge target: by the edges of a scene, or by two distances."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from acquisition.session import Session
from calibration.blind import calibrate_from_distances, calibrate_from_scene
from calibration.edges import EdgeImage, Region
from calibration.errors import CalibrationError
from calibration.psf import PsfCalibration, PsfOrigin
from standoff.terminal import note, progress_bar
from standoff.workflows.edge_sources import Reading
from standoff.workflows.scene_sources import scenes_of_files, scenes_of_session

__all__ = ["calibrate_scenes"]


def calibrate_scenes(
    images: list[Path],
    session: Path | None,
    reading: Reading,
    method: Literal["single-image", "two-distance"],
    rule: Callable[[EdgeImage], Region | None],
    zoom: float | None,
) -> tuple[PsfCalibration, PsfOrigin]:
    """Measure the PSF from photographs or the textured captures of a session.

    Raises
    ------
    CalibrationError
        If they do not tell it.
    """
    scenes = (
        scenes_of_files(images, reading)
        if session is None
        else scenes_of_session(Session(session), reading)
    )
    try:
        if method == "single-image":
            with progress_bar("measuring edges", len(scenes.images)) as bar:
                return (
                    calibrate_from_scene(scenes.images, region=rule, progress=bar.advance_to),
                    scenes.origin,
                )
        if any(scene[0].noise is None for scene in scenes.series):
            note("the noise of the photographs is not known and reads as blur; give --noise")
        with progress_bar("comparing distances", scenes.pairs) as bar:
            return (
                calibrate_from_distances(
                    scenes.series, zoom=zoom, region=rule, progress=bar.advance_to
                ),
                scenes.origin,
            )
    except ValueError as error:
        raise CalibrationError(str(error)) from error
