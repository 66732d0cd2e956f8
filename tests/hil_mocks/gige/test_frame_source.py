from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_mocks.gige._settings import BenchFrameSource, FrameRequest, noise_table
from hil_mocks.truth.render import Sensor

SHAPE = (200, 250)
SENSOR = Sensor(
    white_e_per_us=1.5,
    gain_e_per_dn=5.0,
    read_noise_e=12.0,
    full_well_e=22000.0,
    black_level_dn=64.0,
)


def request(index: int = 0, *, acquisition: int = 1, exposure_us: float = 8000.0) -> FrameRequest:
    return FrameRequest(
        acquisition=acquisition,
        index=index,
        exposure_us=exposure_us,
        gain_db=0.0,
        black_level_dn=64.0,
    )


def flat_source(light: float, **keys: str) -> BenchFrameSource:
    view = np.full(SHAPE, light, np.float32)
    return BenchFrameSource(SENSOR, lambda: view, seed=5, bayer_order=keys.get("bayer_order"))


def frames_of(source: BenchFrameSource, count: int, exposure_us: float) -> NDArray[np.float64]:
    return np.array(
        [source.levels_dn(request(k, exposure_us=exposure_us)) for k in range(count)], np.float64
    )


def test_the_noise_table_is_standard_normal() -> None:
    table = noise_table().astype(np.float64)
    assert table.mean() == pytest.approx(0, abs=1e-6)
    assert table.var() == pytest.approx(1, abs=1e-6)
    # The fourth moment of a normal deviate is 3; the tails beyond 4.2 sigma are missing.
    assert (table**4).mean() == pytest.approx(3, abs=0.01)


@pytest.mark.parametrize("count", [10, 100])
@pytest.mark.parametrize("light", [0.0, 0.06, 0.5, 1.0])
def test_the_temporal_variance_is_that_of_the_sensor_model(count: int, light: float) -> None:
    frames = frames_of(flat_source(light), count, 8000.0)
    view = np.array([light], np.float32)
    expected_dn = float(SENSOR.expected_dn(view, 8000.0, 0.0, "Mono12")[0])
    # 50 000 px: five standard errors of the mean, and of the pooled variance.
    sigma_dn = SENSOR.variance_dn2(expected_dn, 0.0) ** 0.5
    assert frames.mean() == pytest.approx(expected_dn, abs=5 * sigma_dn / (frames.size**0.5))
    pooled_dn2 = frames.var(axis=0, ddof=1).mean()
    relative = 5 * (2 / (50_000 * (count - 1))) ** 0.5
    assert pooled_dn2 == pytest.approx(SENSOR.variance_dn2(expected_dn, 0.0), rel=relative)


def test_averaging_frames_lowers_the_noise_by_the_root_of_their_number() -> None:
    frames = frames_of(flat_source(0.5), 100, 8000.0)
    one, hundred = frames[0].var(), frames.mean(axis=0).var()
    assert one / hundred == pytest.approx(100, rel=0.05)  # 50 000 px: 0.9 % standard error


def test_no_two_pixels_and_no_two_frames_share_their_noise() -> None:
    frames = frames_of(flat_source(0.5), 20, 8000.0)
    residuals = (frames - frames.mean()).reshape(20, -1)
    correlations = np.corrcoef(residuals) - np.eye(20)
    assert np.abs(correlations).max() < 5 / residuals.shape[1] ** 0.5
    # Nor is one frame another one moved on: the largest of 50 000 circular correlations.
    spectra = np.fft.rfft(residuals[:2], axis=1)
    shifted = np.fft.irfft(spectra[0] * spectra[1].conj())
    assert np.abs(shifted).max() / (residuals[0].std() * residuals[1].std()) < 6 * 50_000**0.5


def test_the_noise_is_close_to_that_of_the_exact_model() -> None:
    """Distribution against Poisson and normal draws: two-sample Kolmogorov-Smirnov."""
    view = np.full(SHAPE, 0.06, np.float32)
    ours = BenchFrameSource(SENSOR, lambda: view, seed=5).levels_dn(request())
    exact = SENSOR.expose(SENSOR.electrons(view, 8000.0), 0.0, "Mono12", np.random.default_rng(0))
    levels = np.arange(4096)
    ours_below = np.searchsorted(np.sort(ours.ravel()), levels) / ours.size
    exact_below = np.searchsorted(np.sort(exact.ravel()), levels) / exact.size
    assert np.abs(ours_below - exact_below).max() < 1.95 * (2 / ours.size) ** 0.5  # 0.1 %


def test_a_full_well_keeps_its_mean_and_only_its_read_noise() -> None:
    sensor = Sensor(
        white_e_per_us=1.5,
        gain_e_per_dn=5.0,
        read_noise_e=12.0,
        full_well_e=10_000.0,
        black_level_dn=64.0,
    )
    for light in (0.82, 0.8333, 0.84, 1.0):  # at 8000 us the well is full at 0.8333
        view = np.full(SHAPE, light, np.float32)
        source = BenchFrameSource(sensor, partial(np.asarray, view), seed=1)
        ours = frames_of(source, 4, 8000.0)
        electrons = sensor.electrons(view, 8000.0)
        rng = np.random.default_rng(0)
        exact = np.array([sensor.expose(electrons, 0.0, "Mono12", rng) for _ in range(4)])
        sigma_dn = exact.std()
        assert ours.mean() == pytest.approx(exact.mean(), abs=7 * sigma_dn / exact.size**0.5)
        assert ours.var() == pytest.approx(exact.var(), rel=0.03)  # 200 000 samples: 0.3 %


def test_a_frame_follows_from_its_request_alone() -> None:
    source = flat_source(0.5)
    frame = source.levels_dn(request(3))
    source.levels_dn(request(7, exposure_us=100.0))
    np.testing.assert_array_equal(source.levels_dn(request(3)), frame)
    assert (source.levels_dn(request(4)) != frame).any()
    assert (source.levels_dn(request(3, acquisition=2)) != frame).any()


def test_a_colour_filter_takes_its_part_of_the_light() -> None:
    frames = frames_of(flat_source(1.0, bayer_order="RG"), 10, 4000.0).mean(axis=0) - 64
    red, green, blue = frames[::2, ::2].mean(), frames[::2, 1::2].mean(), frames[1::2, 1::2].mean()
    assert (red / green, blue / green) == pytest.approx((0.55, 0.7), rel=0.01)
    assert frames[1::2, ::2].mean() == pytest.approx(green, rel=0.01)
