"""Where ``calibrate`` without an edge target gets its photographs from, ordered by scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.session import Session
from calibration.edges import EdgeImage
from calibration.psf import PsfOrigin, capture_images, scene_records
from standoff.workflows.edge_sources import Reading, from_files, origin_of

__all__ = ["SceneSources", "scenes_of_files", "scenes_of_session"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSources:
    """Photographs by scene, the nearest of each first, and what is known of the camera."""

    series: tuple[tuple[EdgeImage, ...], ...]
    origin: PsfOrigin

    @property
    def images(self) -> list[EdgeImage]:
        """All photographs, scene by scene."""
        return [image for scene in self.series for image in scene]

    @property
    def pairs(self) -> int:
        """Number of pairs of the nearest photograph of a scene with a further one."""
        return sum(len(scene) - 1 for scene in self.series)


def scenes_of_files(paths: Sequence[Path], reading: Reading) -> SceneSources:
    """Photographs of one scene, the nearest first."""
    sources = from_files(paths, reading)
    return SceneSources(series=(tuple(sources.images),), origin=sources.origin)


def scenes_of_session(session: Session, reading: Reading) -> SceneSources:
    """Captures of textures and charts from two heights or more.

    Raises
    ------
    CalibrationError
        If there are none.
    """
    records = scene_records(session)
    series = tuple(
        tuple(
            capture_images(
                session, scene, correction=reading.correction, frame_noise=reading.frame_noise
            )
        )
        for scene in records
    )
    return SceneSources(
        series=series, origin=origin_of(session, [record for scene in records for record in scene])
    )
