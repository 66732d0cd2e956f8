"""The dark and flat captures that a noise measurement takes, from wherever they come."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

from acquisition.bracket import BracketExposure
from acquisition.session import CaptureRecord, Session
from calibration.errors import NoiseError
from calibration.noise.photon_transfer import QUANTISATION_DN2
from simulation.arrays import FloatImage

NoiseKind = Literal["dark", "flat"]
_KINDS = ("dark", "flat")


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCapture:
    """Frames of one dark or flat level: what is known of them, and how their statistics are had.

    ``load`` returns the mean and the unbiased temporal variance of one frame, both of shape
    ``(rows, cols)``. ``time_s`` is by any clock. ``saturated_pixels`` reached the largest level in
    any of the ``frames``. ``bracket`` has the exposures of a bracket.
    """

    kind: NoiseKind
    name: str
    frames: int
    exposure_us: float | None
    saturated_pixels: int
    load: Callable[[], tuple[FloatImage, FloatImage]] = field(repr=False)
    time_s: float = 0.0
    bracket: tuple[BracketExposure, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCaptures:
    """Dark and flat captures of one camera at one gain.

    Parameters
    ----------
    captures
        At least one dark and one flat.
    max_level_dn
        Largest level that the pixels can have.
    frames_averaged
        Frames in an ordinary capture of this camera.
    usual_exposure_us
        That of ordinary captures: with a dark current the dark map is of the darks nearest to it.
    quantisation_dn2
        Variance of the rounding to whole levels.
    facts
        Further fields of noise.json, by name: the gain, the camera, the time.
    notes
        What there is to say of them.
    """

    captures: tuple[NoiseCapture, ...]
    max_level_dn: float
    frames_averaged: int
    usual_exposure_us: float | None = None
    quantisation_dn2: float = QUANTISATION_DN2
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def of_session(cls, session: Session) -> "NoiseCaptures":
        """Return the dark and flat captures of a session, which are read when they are needed.

        Raises
        ------
        NoiseError
            If darks or flats are missing, or gains or formats are mixed.
        """
        records = noise_records(session)
        camera: Mapping[str, Any] = session.devices.get("camera", {})
        wanted = session.bench.get("camera", {}).get("exposure_us")
        return cls(
            captures=tuple(_of_record(session, record) for record in records),
            max_level_dn=records[0].max_level_dn,
            frames_averaged=_frames_averaged(session.bench, records),
            usual_exposure_us=wanted if isinstance(wanted, int | float) else None,
            facts={
                "gain_db": records[0].gain_db,
                "pixel_format": records[0].pixel_format,
                "camera_serial": _text(camera, "DeviceSerialNumber"),
                "camera_model": _text(camera, "DeviceModelName"),
                "captured_utc": min(record.started_utc for record in records),
            },
        )

    def count(self, kind: NoiseKind) -> int:
        """Number of captures of a kind."""
        return sum(one.kind == kind for one in self.captures)


def noise_records(session: Session) -> list[CaptureRecord]:
    """Return the records of the dark and flat captures of a session.

    Raises
    ------
    NoiseError
        If darks or flats are missing, or gains or formats are mixed.
    """
    records = [
        record for record in session.records if record.kind in _KINDS and record.frames_used > 1
    ]
    kinds = Counter(record.kind for record in records)
    for kind, remedy in (
        ("dark", "put the lens cap on and capture with kind dark"),
        ("flat", "capture an evenly lit white surface with kind flat at several exposures"),
    ):
        if not kinds[kind]:  # type: ignore[index]  # both are kinds
            raise NoiseError(
                f"{session.path}: the session has no {kind} capture of 2 frames or more; {remedy}",
                reason="no_dark" if kind == "dark" else "no_flat",
            )
    settings = {(record.gain_db, record.pixel_format) for record in records}
    if len(settings) > 1:
        listed = ", ".join(f"{gain} dB {pixels}" for gain, pixels in sorted(settings, key=str))
        raise NoiseError(
            f"{session.path}: dark and flat captures have different settings ({listed}); "
            "a noise.json holds for one setting: exclude the others",
            reason="settings",
        )
    return records


def _of_record(session: Session, record: CaptureRecord) -> NoiseCapture:
    def load() -> tuple[FloatImage, FloatImage]:
        images = session.load(record)
        assert images.variance_dn2 is not None  # of several frames
        return images.mean_dn, images.variance_dn2

    return NoiseCapture(
        kind="dark" if record.kind == "dark" else "flat",
        name=record.file,
        frames=record.frames_used,
        exposure_us=record.exposure_us,
        saturated_pixels=record.saturated_pixels,
        load=load,
        time_s=datetime.fromisoformat(record.started_utc).timestamp(),
        bracket=record.bracket,
    )


def _frames_averaged(bench: Mapping[str, Any], records: list[CaptureRecord]) -> int:
    frames = bench.get("capture", {}).get("frames_per_capture")
    if isinstance(frames, int) and frames >= 1:
        return frames
    return Counter(record.frames_used for record in records).most_common(1)[0][0]


def _text(snapshot: Mapping[str, object], key: str) -> str | None:
    value = snapshot.get(key)
    return None if value in (None, "") else str(value)
