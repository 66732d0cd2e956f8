import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.noise import CorrectionMaps
from calibration.noise.document import (
    DARK_DEFECT,
    NOISE_DEFECT,
    RESPONSE_DEFECT,
    correction_maps,
    nonuniformity,
)

SHAPE = (40, 56)
BLACK_DN = 64.0


def maps(seed: int = 0, prnu: float = 0.01, dsnu_dn: float = 1.0) -> CorrectionMaps:
    rng = np.random.default_rng(seed)
    response = 1 + prnu * rng.standard_normal(SHAPE)
    return CorrectionMaps(
        dark_dn=(BLACK_DN + dsnu_dn * rng.standard_normal(SHAPE)).astype(np.float32),
        response=(response / response.mean()).astype(np.float32),
        defects=np.zeros(SHAPE, np.uint8),
        black_level_dn=BLACK_DN,
    )


@given(st.floats(1.0, 3000.0))
def test_an_even_light_comes_out_even_at_any_level(light_dn: float) -> None:
    sensor = maps()
    seen = sensor.dark_dn + light_dn * sensor.response.astype(np.float64)
    np.testing.assert_allclose(sensor.correct(seen), BLACK_DN + light_dn, rtol=1e-9)


def test_a_dark_picture_comes_out_at_the_black_level() -> None:
    np.testing.assert_allclose(maps().correct(maps().dark_dn), BLACK_DN, rtol=1e-12)


def test_variance_follows_the_response_squared() -> None:
    sensor = maps()
    corrected = sensor.correct_variance(sensor.response.astype(np.float64) ** 2 * 7.0)
    np.testing.assert_allclose(corrected, 7.0, rtol=1e-6)


def test_defects_are_found_by_kind_and_filled_from_their_neighbours() -> None:
    sound = maps()
    dark, response = sound.dark_dn.copy(), sound.response.copy()
    ratio = np.ones(SHAPE)
    dark[3, 7] += 50.0
    response[20, 30:32] = 0.1
    ratio[11, 50] = 9.0
    found = correction_maps(
        dark, response, dark_noise_dn=2.4, variance_ratio=ratio, black_level_dn=BLACK_DN
    )
    expected = np.zeros(SHAPE, np.uint8)
    expected[3, 7], expected[11, 50] = DARK_DEFECT, NOISE_DEFECT
    expected[20, 30:32] = RESPONSE_DEFECT
    np.testing.assert_array_equal(found.defects, expected)
    seen = found.dark_dn + 1000.0 * found.response.astype(np.float64)
    np.testing.assert_allclose(found.correct(seen), BLACK_DN + 1000.0, rtol=1e-6)


def test_a_sound_sensor_has_no_defects() -> None:
    sound = maps(seed=3)
    ratio = np.random.default_rng(5).chisquare(60, SHAPE) / 60
    found = correction_maps(
        sound.dark_dn, sound.response, dark_noise_dn=2.4, variance_ratio=ratio, black_level_dn=64.0
    )
    assert not found.is_defect.any()


def test_patterns_are_told_without_the_temporal_noise() -> None:
    rng = np.random.default_rng(8)
    noisy = maps(seed=4)
    dark = noisy.dark_dn + rng.normal(0, 0.5, SHAPE).astype(np.float32)
    sensor = CorrectionMaps(
        dark_dn=dark, response=noisy.response, defects=noisy.defects, black_level_dn=BLACK_DN
    )
    found = nonuniformity(sensor, dark_variance_dn2=0.25, response_variance=0.0)
    assert found.dsnu_dn == pytest.approx(1.0, rel=0.06)  # 2240 px: 1.5 %
    assert found.prnu == pytest.approx(0.01, rel=0.06)
    assert found.defects == 0


def test_maps_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError):
        maps().correct(np.zeros((56, 40)))


def test_maps_of_several_sizes_are_refused_with_the_sizes() -> None:
    flat = np.ones(SHAPE, np.float32)
    with pytest.raises(ValueError):
        CorrectionMaps(
            dark_dn=flat,
            response=flat[:, 1:],
            defects=np.zeros(SHAPE, np.uint8),
            black_level_dn=BLACK_DN,
        )
