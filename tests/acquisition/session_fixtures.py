"""A small bench, plan and session, made of the fakes."""

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.averaging import AveragedFrames
from acquisition.bench import BenchConfig
from acquisition.devices import FrameImage
from acquisition.plan import CapturePlan, PlanEntry, parse_plan
from acquisition.session._journal import Stamps
from acquisition.session._reader import Session
from acquisition.session._record import CaptureRecord, Take
from acquisition.session._writer import SessionWriter
from tests.acquisition.fakes import COLS, ROWS, SETTINGS, FakeUids, FakeUtc

DEVICES: dict[str, dict[str, Any]] = {
    "camera": {"driver": "simulated", "DeviceSerialNumber": "C1", "ExposureTime": 2000.0},
    "stage": {"driver": "simulated", "DeviceSerialNumber": "S1"},
}


def bench_of(**camera: object) -> BenchConfig:
    return BenchConfig.model_validate(
        {
            "camera": {
                "driver": "simulated",
                "pixel_format": "Mono12",
                "exposure_us": 2000.0,
                "gain_db": 0.0,
                "frame_rate_hz": 50.0,
                **camera,
            },
            "stage": {"driver": "simulated", "limits_mm": [0.0, 300.0], "tolerance_mm": 0.01},
            "optics": {"focal_length_mm": 8.0, "pixel_pitch_um": 8.3},
            "capture": {"frames_per_capture": 3},
        }
    )


def plan_of(**changes: object) -> CapturePlan:
    """Two orientations of an edge and a flat, two heights each: six captures."""
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "small",
            "heights_mm": [100.0, 110.0],
            "targets": [
                {"kind": "edge", "target": "Kante", "orientations_deg": [5.0, 95.0]},
                {"kind": "flat", "target": "paper"},
            ],
            **changes,
        },
        source="plan",
    )


def writer(
    path: Path,
    *,
    plan: CapturePlan | None = None,
    bench: BenchConfig | None = None,
    devices: dict[str, dict[str, Any]] | None = None,
    prefix: str = "uid",
) -> SessionWriter:
    return SessionWriter(
        path,
        plan=plan or plan_of(),
        bench=bench or bench_of(),
        devices=DEVICES if devices is None else devices,
        operator="Zoë",
        stamps=Stamps(utc_now=FakeUtc(), new_uid=FakeUids(prefix)),
    )


def averaged(level: float = 1000.0) -> AveragedFrames:
    return AveragedFrames(
        mean_dn=np.full((ROWS, COLS), level, np.float32),
        variance_dn2=np.full((ROWS, COLS), 2.0, np.float32),
        frames_used=3,
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=0,
        min_dn=int(level),
        max_dn=int(level),
        first_timestamp_ns=1,
        last_timestamp_ns=2,
    )


def add(
    session: SessionWriter,
    entry: PlanEntry,
    level: float = 1000.0,
    raw_frames: tuple[FrameImage, ...] = (),
) -> CaptureRecord:
    now = FakeUtc()
    return session.add_capture(
        entry,
        Take(
            averaged=averaged(level),
            settings=SETTINGS,
            height_mm=entry.height_mm + 0.002,
            focus_value=0.5,
            started=now(),
            finished=now(),
            raw_frames=raw_frames,
        ),
    )


def whole_session(path: Path) -> tuple[CaptureRecord, ...]:
    """Capture every entry of the small plan."""
    with writer(path) as session:
        return tuple(add(session, entry, 1000.0 + entry.index) for entry in session.entries)


def session_with(session: Session, **changes: Any) -> Session:
    """A session as if its ``manifest`` or ``captures`` were others."""
    other = copy(session)
    for name, value in changes.items():
        setattr(other, f"_{name}", value)
    return other
