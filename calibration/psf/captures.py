"""The captures of a session as input to the PSF calibration, and the camera that took them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.session import CaptureRecord, Session
from calibration.choices import Channel
from calibration.edges import EdgeImage
from calibration.errors import CalibrationError, NoEdgeError
from calibration.noise import CorrectionMaps, LevelNoise, fit_level_noise
from calibration.psf.document import CameraIdentity, PsfOrigin
from simulation.arrays import AnyArray, FloatArray

REC601_LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601-7, section 2.5.1


def luma_plane(image: AnyArray, channel: Channel = "luma") -> FloatArray:
    """Return one float64 plane of a grey or colour image.

    Colours are red, green, blue, then an alpha channel that is ignored; luma is Rec. 601's, the
    only channel of a grey image.
    """
    plane = np.asarray(image)
    if plane.ndim == 3 and plane.shape[2] in (1, 2):
        plane = plane[:, :, 0]
    if plane.ndim == 2:
        if channel != "luma":
            raise ValueError(f"a grey image has no {channel} channel")
        return plane.astype(np.float64)
    if plane.ndim != 3 or plane.shape[2] not in (3, 4):
        raise ValueError(f"an image has shape (rows, cols) or (rows, cols, 3), got {plane.shape}")
    colours = plane[:, :, :3].astype(np.float64)
    if channel == "luma":
        return np.asarray(colours @ np.array(REC601_LUMA))
    return np.asarray(colours[:, :, ("red", "green", "blue").index(channel)])


EDGE_KINDS = ("edge", "board")
SCENE_KINDS = ("texture", "chart")


def edge_records(session: Session) -> list[CaptureRecord]:
    """Return the captures from which a PSF can be measured."""
    records = [record for record in session.records if record.kind in EDGE_KINDS]
    if not records:
        raise NoEdgeError(
            f"{session.path}: the session has no capture of kind edge or board; capture one"
        )
    return records


def scene_records(session: Session) -> list[list[CaptureRecord]]:
    """Captures of each placement of a textured target, nearest first, without repeats."""
    targets: dict[tuple[str, float], dict[float, CaptureRecord]] = {}
    for record in session.records:
        if record.kind in SCENE_KINDS:
            heights = targets.setdefault((record.target, record.orientation_deg), {})
            heights.setdefault(round(record.height_asked_mm, 3), record)
    series = [
        sorted(heights.values(), key=lambda record: record.height_mm)
        for heights in targets.values()
        if len(heights) > 1
    ]
    if not series:
        raise CalibrationError(
            f"{session.path}: no target of kind texture or chart was captured at two heights; "
            "capture one"
        )
    return series


def edge_images(
    session: Session,
    *,
    correction: CorrectionMaps | None = None,
    frame_noise: LevelNoise | None = None,
) -> Iterator[EdgeImage]:
    """Load the edge captures one by one; see ``capture_images``."""
    return capture_images(
        session, edge_records(session), correction=correction, frame_noise=frame_noise
    )


def capture_images(
    session: Session,
    records: Sequence[CaptureRecord],
    *,
    correction: CorrectionMaps | None = None,
    frame_noise: LevelNoise | None = None,
) -> Iterator[EdgeImage]:
    """Load captures one by one, each with its own noise.

    The noise is fitted to the temporal variance stored with the capture. A single frame has no
    variance: its noise is ``frame_noise``, or, without that, what the edge fit estimates from its
    residuals. The maps of ``correction`` apply to every capture and its variance.
    """
    for record in records:
        images = session.load(record)
        mean = images.mean_dn.astype(np.float64)
        variance: NDArray[np.floating[Any]] | None = images.variance_dn2
        clipped = None
        if correction is not None:
            try:
                # Dividing by the response moves the level at which a pixel clips.
                clipped = mean >= record.max_level_dn
                mean = correction.correct(mean)
                variance = None if variance is None else correction.correct_variance(variance)
            except ValueError as error:
                raise CalibrationError(f"{record.file}: {error}") from error
        noise = frame_noise
        if variance is not None:
            single = fit_level_noise(mean, variance, record.max_level_dn)
            noise = single.averaged(record.frames_used)
        yield EdgeImage(
            name=record.file,
            image_dn=mean,
            capture=record.index,
            height_mm=record.height_mm,
            noise=noise,
            saturation_dn=record.max_level_dn,
            clipped=clipped,
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
        photograph=_taken_with(session, records),
    )


def _taken_with(
    session: Session, records: Sequence[CaptureRecord]
) -> dict[str, str | float] | None:
    """Lens, exposure and pixel pitch of a session: of its bench, or of imported photographs."""
    bench = session.bench or {}
    tables = (session.devices.get("camera"), session.devices.get("lens"), bench.get("optics"))
    stated = {key: value for one in tables if isinstance(one, dict) for key, value in one.items()}
    facts: dict[str, str | float] = {}
    for name in ("lens", "focal_length_mm", "f_number", "iso", "pixel_pitch_um"):
        value = stated.get(name)
        if isinstance(value, str | int | float) and value:
            facts[name] = value
    exposures = {record.exposure_us for record in records}
    exposure_us = exposures.pop() if len(exposures) == 1 else None
    if exposure_us is not None:
        facts["exposure_s"] = exposure_us / 1e6
    return facts or None


def _text(snapshot: Mapping[str, object], key: str) -> str | None:
    value = snapshot.get(key)
    return None if value in (None, "") else str(value)
