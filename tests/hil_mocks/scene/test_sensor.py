import numpy as np
import pytest
from numpy.typing import NDArray

from hil_mocks.truth.render import Sensor


def sensor(**values: float) -> Sensor:
    return Sensor(
        **{
            "white_e_per_us": 1.5,
            "gain_e_per_dn": 5.0,
            "read_noise_e": 12.0,
            "full_well_e": 30000.0,
            "black_level_dn": 64.0,
        }
        | values
    )


def flat(level: float, shape: tuple[int, int] = (200, 300)) -> NDArray[np.float32]:
    return np.full(shape, level, dtype=np.float32)


def test_variance_against_mean_gives_back_gain_and_read_noise() -> None:
    camera = sensor()
    rng = np.random.default_rng(5)
    means, variances = [], []
    for exposure_us in (0.0, 1000.0, 3000.0, 6000.0, 10000.0):
        first, second = (
            camera.expose(camera.electrons(flat(1.0), exposure_us), 0.0, "Mono12", rng).astype(
                np.float64
            )
            for _ in range(2)
        )
        means.append((first.mean() + second.mean()) / 2)
        variances.append((first - second).var() / 2)
    slope, _ = np.polyfit(means, variances, 1)
    # 60 000 px: a variance is known to 0.8 %, the slope of five of them to about 1 %.
    assert 1 / slope == pytest.approx(5.0, rel=0.02)
    # The dark one carries the read noise, its rounding is 1/12 DN^2.
    assert np.sqrt(variances[0] - 1 / 12) * 5.0 == pytest.approx(12.0, rel=0.02)


def test_the_model_of_the_variance_is_the_variance() -> None:
    camera = sensor()
    light = flat(1.0, (500, 800))
    frame = camera.expose(
        camera.electrons(light, 4000.0), 6.0, "Mono12", np.random.default_rng(1)
    ).astype(np.float64)
    expected_dn = float(camera.expected_dn(light[:1, :1], 4000.0, 6.0, "Mono12")[0, 0])
    assert frame.mean() == pytest.approx(expected_dn, abs=5 * frame.std() / 632)  # 400 000 px
    assert frame.var() == pytest.approx(camera.variance_dn2(expected_dn, 6.0), rel=0.012)


def test_twenty_db_make_the_signal_ten_times_larger() -> None:
    assert sensor().gain_at_e_per_dn(20.0) == pytest.approx(0.5)


def test_the_converter_saturates_at_4095() -> None:
    frame = sensor().expose(flat(1e6), 0.0, "Mono12", np.random.default_rng(0))
    assert frame.dtype == np.uint16
    assert (frame == 4095).all()


def test_a_full_well_saturates_below_the_converter() -> None:
    # 10 000 e- / 5 + 64 = 2064 DN, with the read noise of 2.4 DN about it.
    frame = sensor(full_well_e=10000.0).expose(flat(1e6), 0.0, "Mono12", np.random.default_rng(0))
    assert frame.mean() == pytest.approx(2064.0, abs=0.05)
    assert frame.std() == pytest.approx(2.4, rel=0.02)


def test_the_dark_is_clipped_at_zero() -> None:
    frame = sensor(black_level_dn=0.0).expose(flat(0.0), 0.0, "Mono12", np.random.default_rng(0))
    assert frame.min() == 0
    assert (frame == 0).mean() == pytest.approx(0.58, abs=0.02)  # Phi(0.5 / 2.4)


def test_mono8_is_the_upper_eight_of_the_twelve_bits() -> None:
    electrons = sensor().electrons(flat(1.0), 5000.0)
    deep = sensor().expose(electrons, 0.0, "Mono12", np.random.default_rng(7))
    shallow = sensor().expose(electrons, 0.0, "Mono8", np.random.default_rng(7))
    assert shallow.dtype == np.uint8
    np.testing.assert_array_equal(shallow, deep >> 4)


def test_the_expected_mono8_level_knows_of_the_bits_cut_off() -> None:
    camera = sensor()
    frame = camera.expose(
        camera.electrons(flat(1.0), 5000.0), 0.0, "Mono8", np.random.default_rng(7)
    )
    expected_dn = camera.expected_dn(flat(1.0)[:1, :1], 5000.0, 0.0, "Mono8")[0, 0]
    assert frame.mean() == pytest.approx(expected_dn, abs=0.03)  # 60 000 px of sigma 1.1 DN


def test_no_negative_light() -> None:
    assert (sensor().electrons(flat(-0.01), 1000.0) == 0).all()
