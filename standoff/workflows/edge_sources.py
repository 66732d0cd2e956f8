"""Where ``calibrate`` gets its photographs from: files, or the edge captures of a session."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.session import CaptureRecord, Session
from calibration.choices import Channel, Pattern
from calibration.edges import EdgeImage, plane_places
from calibration.errors import CalibrationError
from calibration.noise import CorrectionMaps, LevelNoise
from calibration.psf import (
    CameraIdentity,
    PsfOrigin,
    edge_images,
    edge_records,
    luma_plane,
    srgb_to_linear,
)
from standoff.terminal import note
from standoff.workflows.image_files import ImageFile, read_image

_CLIPPED_FROM = 0.995  # of the saturation level


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """How pixels become a plane linear in light.

    In a mosaic (``pattern``), all colours are measured; ``channel`` is the one shown.
    ``correction`` holds the correction maps of the sensor, ``frame_noise`` the noise of a frame
    for photographs whose noise is unknown.
    """

    is_srgb: bool = False
    channel: Channel = "luma"
    pattern: Pattern | None = None
    correction: CorrectionMaps | None = None
    frame_noise: LevelNoise | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSources:
    """The photographs, read one at a time, and a way to read one again by name."""

    count: int
    images: Iterator[EdgeImage]
    load: Callable[[str], NDArray[np.floating[Any]]]
    origin: PsfOrigin
    session: Session | None = None


def from_session(session: Session, reading: Reading) -> EdgeSources:
    """Return the edge captures of a session.

    Raises
    ------
    NoEdgeError
        If it has no edge captures.
    """
    records = {record.file: record for record in edge_records(session)}

    def load(name: str) -> NDArray[np.floating[Any]]:
        mean_dn: NDArray[np.floating[Any]] = session.load(records[name]).mean_dn
        if reading.correction is not None:
            mean_dn = reading.correction.correct(mean_dn)
        return _shown(mean_dn, reading)

    return EdgeSources(
        count=len(records),
        images=edge_images(session, correction=reading.correction, frame_noise=reading.frame_noise),
        load=load,
        origin=replace(
            origin_of(session, list(records.values())),
            channel=reading.channel if reading.pattern else None,
        ),
        session=session,
    )


def from_files(paths: Sequence[Path], reading: Reading) -> EdgeSources:
    """Return photographs of edges, each read when it is needed."""

    def images() -> Iterator[EdgeImage]:
        for path in paths:
            file = read_image(path)
            if reading.channel == "luma" and file.is_colour:
                note(f"{path}: colour read as Rec. 601 luma; --channel chooses one colour")
            yield edge_image(file, reading)

    def load(name: str) -> NDArray[np.floating[Any]]:
        return _shown(edge_image(read_image(Path(name)), reading).image_dn, reading)

    channel = reading.channel if reading.pattern or reading.channel != "luma" else None
    return EdgeSources(
        count=len(paths), images=images(), load=load, origin=PsfOrigin(channel=channel)
    )


def origin_of(session: Session, records: Sequence[CaptureRecord]) -> PsfOrigin:
    """Return the camera of a session, and when the first of these captures was taken."""
    camera = session.devices.get("camera", {})
    return PsfOrigin(
        camera=CameraIdentity(
            serial=_text(camera, "DeviceSerialNumber"),
            model=_text(camera, "DeviceModelName"),
            vendor=_text(camera, "DeviceVendorName"),
        ),
        captured_utc=min(record.started_utc for record in records),
    )


def _text(snapshot: Mapping[str, object], key: str) -> str | None:
    value = snapshot.get(key)
    return None if value in (None, "") else str(value)


def edge_image(file: ImageFile, reading: Reading) -> EdgeImage:
    """Return a photograph of edges as a plane linear in light, with its clipped pixels.

    Raises
    ------
    CalibrationError
        If the photograph is not of the kind that ``reading`` asks for.
    """
    pixels, saturation = file.pixels, file.saturation_dn
    full_scale = file.full_scale_dn or 1.0
    if reading.is_srgb:
        pixels = srgb_to_linear(pixels, full_scale)
        if saturation is not None:
            saturation = float(srgb_to_linear(np.array([saturation]), full_scale)[0])
    if reading.pattern is not None and file.is_colour:
        raise CalibrationError(
            f"{file.path}: a colour photograph is not a raw mosaic; leave out --bayer"
        )
    channel = "luma" if reading.pattern is not None else reading.channel
    try:
        plane = luma_plane(pixels, channel)
    except ValueError as error:
        raise CalibrationError(f"{file.path}: {error}") from error
    clipped = None
    if reading.correction is not None:
        if file.is_colour:
            raise CalibrationError(
                f"{file.path}: a colour image, but the maps are of a grey camera; "
                "leave out --correct"
            )
        clipped = None if saturation is None else plane >= saturation
        try:
            plane = reading.correction.correct(plane)
        except ValueError as error:
            raise CalibrationError(f"{file.path}: {error}") from error
    source = EdgeImage(
        name=str(file.path),
        image_dn=plane,
        noise=reading.frame_noise,
        saturation_dn=saturation,
        is_jpeg=file.is_jpeg,
        clipped=clipped,
    )
    if channel != "luma" or not file.is_colour or file.saturation_dn is None:
        return source
    # One clipped colour distorts the luma, though the luma itself is below saturation.
    colours = file.colour_planes.astype(np.float64)
    clipped = (colours >= _CLIPPED_FROM * file.saturation_dn) | (colours <= 0)
    return replace(source, clipped=np.asarray(clipped.any(axis=2)))


def _shown(image: NDArray[np.floating[Any]], reading: Reading) -> NDArray[np.floating[Any]]:
    """The image as figures show it: for a mosaic the pixels of one colour, NaN elsewhere."""
    if reading.pattern is None:
        return image
    shown = np.full(image.shape, np.nan)
    for plane in plane_places(reading.pattern):
        if plane.colour == reading.channel:
            part = np.s_[plane.first_y_px :: 2, plane.first_x_px :: 2]
            shown[part] = image[part]
    return shown
