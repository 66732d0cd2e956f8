"""Predicted errors are the scatter of sessions carried out, in small."""

import numpy as np
import pytest

import standoff
from benchmarks.truth.study_sessions import StudiedSession, calibrated

REPETITIONS = 30
# A scatter of 30 results is known to 1 / sqrt(60), 13 %: three and a half times that.
WITHIN = 1.5


@pytest.mark.slow
@pytest.mark.parametrize("focus_scatter_px2", [0.0, 0.02])
def test_sigma_scatters_as_predicted(focus_scatter_px2: float) -> None:
    session = StudiedSession(
        name="small",
        plan={
            "frames_per_capture": 3,
            "targets": [
                {
                    "kind": "edge",
                    "target": "edge",
                    "orientations_deg": [6.0, 48.0, 96.0, 138.0],
                    "heights_mm": [250.0],
                }
            ],
        },
        bench={"width_px": 72, "height_px": 64},
        exposure_us=2000.0,
        focus_scatter_px2=focus_scatter_px2,
    )
    rng = np.random.default_rng(8)
    study = standoff.plan_study(
        session.capture_plan,
        session.config,
        calibrated(session, rng),
        focus_scatter_px2=focus_scatter_px2,
    )
    widths = [calibrated(session, rng).sigma_x_px for _ in range(REPETITIONS)]
    ratio = (study.of("sigma_x_px").err or 0.0) / float(np.std(np.array(widths), ddof=1))
    assert 1 / WITHIN < ratio < WITHIN
