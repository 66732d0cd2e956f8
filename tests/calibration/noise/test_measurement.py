from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.session._reader import Session
from calibration.errors import NoiseError
from calibration.noise import noise_of_captures
from calibration.noise._document import NOISE_DEFECT
from calibration.noise._measurement import _noise_records
from tests.acquisition.session_fixtures import session_with
from tests.calibration.noise_session import DARKS_US, FLATS_US, FRAMES, SHAPE, noise_session
from tests.calibration.poisson_frames import BLACK_DN, GAIN_E_PER_DN, READ_NOISE_E

DARK_DN_PER_US = 1e-3


def with_bench(session: Session, bench: Mapping[str, Any]) -> Session:
    return session_with(session, manifest=replace(session.manifest, bench=bench))


def test_the_camera_model_is_read_back_from_a_session(tmp_path: Path) -> None:
    done: list[int] = []
    found = noise_of_captures(noise_session(tmp_path / "s"), done.append)
    assert found.transfer.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-5)  # float32
    assert found.transfer.read_noise_e == pytest.approx(READ_NOISE_E, rel=1e-5)
    known = found.calibration
    assert (known.darks, known.flats) == (len(DARKS_US), len(FLATS_US))
    assert (known.gain_db, known.pixel_format, known.camera_serial) == (0.0, "Mono12", "C1")
    assert not found.maps.is_defect.any()
    # Every capture is read twice.
    assert done == list(range(1, 2 * (len(DARKS_US) + len(FLATS_US)) + 1))


def test_captures_of_two_gains_are_refused_with_both(tmp_path: Path) -> None:
    session = noise_session(tmp_path / "s", flat_gain_db=6.0)
    with pytest.raises(NoiseError) as refused:
        _noise_records(session)
    assert refused.value.reason == "settings"
    for setting in ("0.0 dB Mono12", "6.0 dB Mono12"):
        assert setting in str(refused.value)


def test_a_pixel_that_flickers_is_marked_and_left_out_of_the_read_noise(tmp_path: Path) -> None:
    # Alone among 2240 it would raise the mean variance from 5.84 to 8.1 DN^2.
    flickering = np.zeros(SHAPE)
    flickering[7, 30] = 5000.0
    found = noise_of_captures(noise_session(tmp_path / "s", extra_variance_dn2=flickering))
    expected = np.zeros(SHAPE, np.uint8)
    expected[7, 30] = NOISE_DEFECT
    np.testing.assert_array_equal(found.maps.defects, expected)
    assert found.nonuniformity.defects == 1
    assert found.transfer.read_noise_e == pytest.approx(READ_NOISE_E, rel=1e-5)
    assert found.transfer.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-5)


def test_with_a_dark_current_the_map_is_that_of_the_darks_nearest_the_bench_exposure(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(2)
    by_pixel = DARK_DN_PER_US * (1 + 0.05 * rng.standard_normal(SHAPE))
    session = noise_session(tmp_path / "s", dark_dn_per_us=by_pixel)
    found = noise_of_captures(session)
    assert found.transfer.dark.black_level_dn == pytest.approx(BLACK_DN, abs=1e-3)
    # 3000 us is nearest to the bench's 2000 us.
    np.testing.assert_allclose(found.maps.dark_dn, BLACK_DN + 3000.0 * by_pixel, atol=1e-4)
    # A bench that says nothing takes the mean of all.
    unknown = noise_of_captures(with_bench(session, {}))
    mean_us = np.mean(DARKS_US)
    np.testing.assert_allclose(unknown.maps.dark_dn, BLACK_DN + mean_us * by_pixel, atol=1e-4)


def test_the_frames_averaged_are_the_benchs_or_else_those_of_most_captures(tmp_path: Path) -> None:
    session = noise_session(tmp_path / "s")
    assert noise_of_captures(session).calibration.frames_averaged == 3
    assert (
        noise_of_captures(with_bench(session, {"capture": {}})).calibration.frames_averaged
        == FRAMES
    )
