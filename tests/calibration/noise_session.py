"""A capture session of darks and flats whose means and variances are those of the camera model."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.averaging import AveragedFrames
from acquisition.session._reader import Session
from acquisition.session._record import Take
from simulation.arrays import FloatArray
from tests.acquisition.fakes import SETTINGS, FakeUtc
from tests.acquisition.session_fixtures import plan_of, writer
from tests.calibration.poisson_frames import BLACK_DN, GAIN_E_PER_DN, READ_NOISE_E

FRAMES = 10
SHAPE = (40, 56)
LIGHT_DN_PER_US = 0.25
DARKS_US = (21.0, 3000.0, 14000.0)
FLATS_US = (1000.0, 3000.0, 5000.0, 8000.0)


def captured(
    is_dark: bool,
    exposure_us: float,
    *,
    dark_dn_per_us: float | FloatArray = 0.0,
    extra_variance_dn2: float | FloatArray = 0.0,
) -> AveragedFrames:
    """The expectation of FRAMES frames: v = read noise^2 + 1/12 + level / gain, without scatter."""
    collected = dark_dn_per_us * exposure_us + (0.0 if is_dark else LIGHT_DN_PER_US * exposure_us)
    light = np.broadcast_to(collected, SHAPE)
    variance = (READ_NOISE_E / GAIN_E_PER_DN) ** 2 + 1 / 12 + light / GAIN_E_PER_DN
    return AveragedFrames(
        mean_dn=(BLACK_DN + light).astype(np.float32),
        variance_dn2=(variance + extra_variance_dn2).astype(np.float32),
        frames_used=FRAMES,
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=0,
        min_dn=0,
        max_dn=4000,
        first_timestamp_ns=1,
        last_timestamp_ns=2,
    )


def noise_session(
    path: Path,
    *,
    dark_dn_per_us: float | FloatArray = 0.0,
    extra_variance_dn2: float | FloatArray = 0.0,
    flat_gain_db: float = 0.0,
) -> Session:
    """Darks and flats of one camera; its bench exposes for 2000 us and averages 3 frames."""
    ladders = (("dark", DARKS_US), ("flat", FLATS_US))
    plan = plan_of(
        heights_mm=[100.0],
        targets=[
            {"kind": kind, "target": kind, "exposure_us": list(ladder)} for kind, ladder in ladders
        ],
    )
    now = FakeUtc()
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            assert entry.exposure_us is not None
            is_dark = entry.kind == "dark"
            session.add_capture(
                entry,
                Take(
                    averaged=captured(
                        is_dark,
                        entry.exposure_us,
                        dark_dn_per_us=dark_dn_per_us,
                        extra_variance_dn2=extra_variance_dn2,
                    ),
                    settings=replace(
                        SETTINGS,
                        exposure_us=entry.exposure_us,
                        gain_db=0.0 if is_dark else flat_gain_db,
                    ),
                    height_mm=100.0,
                    focus_value=None,
                    started=now(),
                    finished=now(),
                ),
            )
    return Session(path)
