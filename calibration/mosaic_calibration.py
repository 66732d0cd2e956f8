"""The PSF from photographs that are raw mosaics: each colour on its own plane."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from calibration.edge_measurement import EdgeImage, EdgeMeasurement, Method, Region, measure_edges
from calibration.errors import NoEdgeError
from calibration.mosaic import PITCH_PX, Pattern, PlanePlace, plane_places
from calibration.psf_calibration import PsfCalibration, psf_of_edges, why_no_edge

__all__ = ["COLOURS", "calibrate_mosaic", "plane_source"]

COLOURS = ("red", "green", "blue")


def plane_source(source: EdgeImage, place: PlanePlace) -> EdgeImage:
    """Return one colour plane of a photograph that is a mosaic."""
    clipped = source.clipped
    return replace(
        source,
        image_dn=place.plane(source.image_dn),
        clipped=None if clipped is None else place.plane(clipped).astype(np.bool_),
        pitch_px=PITCH_PX,
        first_x_px=place.first_x_px,
        first_y_px=place.first_y_px,
        sensor_shape=source.frame,
    )


def calibrate_mosaic(
    sources: Iterable[EdgeImage],
    pattern: Pattern,
    channel: str = "green",
    *,
    method: Method = "all-angles",
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF of every colour of a mosaic, in pixels of the sensor.

    Parameters
    ----------
    sources
        The mosaics, read one at a time.
    pattern
        Colours of the mosaic.
    channel
        The colour whose values are returned; the others stand in ``channels``.
    method, region, progress
        As in ``calibrate_psf``.

    Raises
    ------
    NoEdgeError
        If that colour has no edge that may count.
    """
    edges: dict[str, list[EdgeMeasurement]] = {colour: [] for colour in COLOURS}
    names: list[str] = []
    frames: set[tuple[int, int]] = set()
    for done, source in enumerate(sources, start=1):
        names.append(source.name)
        frames.add(source.frame)
        chosen = region(source)
        for place in plane_places(pattern):
            plane = plane_source(source, place)
            edges[place.colour].extend(measure_edges(plane, chosen, method))
        progress(done)
    if not any(edge.is_used for edge in edges[channel]):
        raise NoEdgeError(why_no_edge([f"{name} ({channel})" for name in names], edges[channel]))
    frame = frames.pop() if len(frames) == 1 else None
    channels = {
        colour: psf_of_edges(found, method, frame if colour == channel else None)
        for colour, found in edges.items()
        if any(edge.is_used for edge in found)
    }
    return replace(channels[channel], channels=channels)
