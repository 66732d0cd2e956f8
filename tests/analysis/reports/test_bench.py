from dataclasses import replace

import numpy as np
import pytest

from acquisition.session._reader import Session
from analysis.reports._bench import (
    NoiseSample,
    captures_section,
    noise_section,
    plot_noise,
    plot_stage,
    stage_section,
)
from calibration.noise import LevelNoise
from calibration.psf import PsfCalibration
from tests.acquisition.session_fixtures import session_with
from tests.calibration.edge_session import FRAME_NOISE, FRAMES


def test_gain_and_read_noise_are_those_of_the_frames(session: Session, psf: PsfCalibration) -> None:
    section = noise_section(session, psf)
    assert section is not None
    [row] = section.tables[0].rows
    # 9900 pixels of 10 frames give the slope to about 1 %; black lies at 0 DN here.
    assert float(row[0]) == pytest.approx(1 / FRAME_NOISE.slope_dn, rel=0.05)
    assert float(row[1]) == pytest.approx(np.sqrt(FRAME_NOISE.offset_dn2), rel=0.5)
    assert row[3] == str(FRAMES)


@pytest.mark.slow
def test_averaging_is_measured_against_the_root_of_the_frames(
    session: Session, psf: PsfCalibration
) -> None:
    section = noise_section(session, psf)
    assert section is not None
    assert f"Averaging {FRAMES} frames leaves 0.3" in section.text[1]
    assert "1/√10 = 0.316" in section.text[1]
    without = noise_section(session, None)
    assert without is not None
    assert len(without.text) == 1


def test_noise_that_does_not_rise_has_no_gain() -> None:
    rng = np.random.default_rng(1)
    mean = rng.uniform(100, 1000, 5000)
    sample = NoiseSample(
        mean_dn=mean,
        variance_dn2=np.full(5000, 9.0),
        noise=LevelNoise(offset_dn2=9.0, slope_dn=-1e-4, floor_dn2=1.0),
        frames=10,
        black_level_dn=0.0,
    )
    assert sample.gain_e_per_dn is None
    assert sample.read_noise_dn == pytest.approx(3.0)
    assert plot_noise(sample).axes[0].get_ylabel() == "variance of one frame / DN²"


def test_the_stage_is_compared_with_what_was_asked(session: Session) -> None:
    section = stage_section(session)
    assert section is not None
    # Every height was read back 2 micrometres higher.
    assert "mean +2.0 µm, largest 2.0 µm" in section.text[0]
    line = plot_stage(session.records).axes[0].get_lines()[0]
    np.testing.assert_allclose(np.asarray(line.get_ydata()), 2.0, rtol=1e-6)
    assert stage_section(session_with(session, captures=())) is None


def test_a_capture_that_was_left_out_says_why(session: Session) -> None:
    first, *others = session.captures
    marked = replace(first, excluded_because="lamp flickered")
    section = captures_section(session_with(session, captures=(marked, *others)))
    assert section.tables[0].rows[0][-1] == "excluded: lamp flickered"
