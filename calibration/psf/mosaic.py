"""The PSF of every colour of a raw mosaic."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from calibration.choices import Pattern
from calibration.edges import (
    PITCH_PX,
    EdgeImage,
    EdgeMeasurement,
    EdgeSelection,
    Method,
    PlanePlace,
    plane_places,
)
from calibration.psf.calibration import no_edge_error, psf_of_edges
from calibration.psf.document import ColourPsf, PsfCalibration
from calibration.sharpness import with_sharpness

_TARGET = EdgeSelection()
COLOURS = ("red", "green", "blue")


def plane_source(source: EdgeImage, place: PlanePlace) -> EdgeImage:
    """Return one colour plane of a mosaic photograph."""
    clipped, masked = (
        None if mask is None else place.plane(mask).astype(np.bool_)
        for mask in (source.clipped, source.masked)
    )
    return replace(
        source,
        image_dn=place.plane(source.image_dn),
        clipped=clipped,
        masked=masked,
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
    selection: EdgeSelection = _TARGET,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF of every colour of a mosaic, in pixels of the sensor.

    Parameters
    ----------
    sources
        The mosaics, read one at a time.
    pattern
        Bayer pattern of the mosaic.
    channel
        The colour whose values are returned; the others are in ``channels``.
    method, selection, progress
        As in ``calibrate_psf``.

    Raises
    ------
    NoEdgeError
        If that colour has no usable edge.
    """
    edges: dict[str, list[EdgeMeasurement]] = {colour: [] for colour in COLOURS}
    names: list[str] = []
    frames: set[tuple[int, int]] = set()
    for source in sources:
        names.append(source.name)
        frames.add(source.frame)
        coloured = replace(source, pattern=pattern)
        for place in plane_places(pattern):
            plane = plane_source(source, place)
            found = selection.measured_in(plane, method)
            shown = coloured if place.colour == channel else source
            edges[place.colour].extend(with_sharpness(found, shown))
        progress(len(names))
        del source, coloured, shown, plane
    if not any(edge.is_used for edge in edges[channel]):
        raise no_edge_error([f"{name} ({channel})" for name in names], edges[channel], PITCH_PX)
    frame = frames.pop() if len(frames) == 1 else None
    channels = {
        colour: psf_of_edges(found, method, frame if colour == channel else None)
        for colour, found in edges.items()
        if any(edge.is_used for edge in found)
    }
    colours = {
        colour: ColourPsf.of(one.total, one.optical, edge_count=len(one.edges_used))
        for colour, one in channels.items()
    }
    return channels[channel].model_copy(update={"channels": colours})
