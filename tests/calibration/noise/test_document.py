"""noise.json and its maps: what is written is read back, what is damaged is named."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.untrusted import TiffDamageError
from calibration.documents import json_object
from calibration.errors import NoiseFileError
from calibration.files import _write_noise_files, read_correction, read_noise
from calibration.noise import (
    CorrectionMaps,
    NoiseCalibration,
    NoiseMeasurement,
    noise_of_captures,
    write_map_files,
)
from calibration.noise._document import (
    DARK_DEFECT,
    NOISE_DEFECT,
    RESPONSE_DEFECT,
    correction_maps,
    nonuniformity,
)
from tests.calibration.noise_session import SHAPE, noise_session
from tests.calibration.poisson_frames import GAIN_E_PER_DN

MAP_SHAPE = (40, 56)
BLACK_DN = 64.0


def maps(seed: int = 0, prnu: float = 0.01, dsnu_dn: float = 1.0) -> CorrectionMaps:
    rng = np.random.default_rng(seed)
    response = 1 + prnu * rng.standard_normal(MAP_SHAPE)
    return CorrectionMaps(
        dark_dn=(BLACK_DN + dsnu_dn * rng.standard_normal(MAP_SHAPE)).astype(np.float32),
        response=(response / response.mean()).astype(np.float32),
        defects=np.zeros(MAP_SHAPE, np.uint8),
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
    ratio = np.ones(MAP_SHAPE)
    dark[3, 7] += 50.0
    response[20, 30:32] = 0.1
    ratio[11, 50] = 9.0
    found = correction_maps(
        dark, response, dark_noise_dn=2.4, variance_ratio=ratio, black_level_dn=BLACK_DN
    )
    expected = np.zeros(MAP_SHAPE, np.uint8)
    expected[3, 7], expected[11, 50] = DARK_DEFECT, NOISE_DEFECT
    expected[20, 30:32] = RESPONSE_DEFECT
    np.testing.assert_array_equal(found.defects, expected)
    seen = found.dark_dn + 1000.0 * found.response.astype(np.float64)
    np.testing.assert_allclose(found.correct(seen), BLACK_DN + 1000.0, rtol=1e-6)


def test_a_sound_sensor_has_no_defects() -> None:
    sound = maps(seed=3)
    ratio = np.random.default_rng(5).chisquare(60, MAP_SHAPE) / 60
    found = correction_maps(
        sound.dark_dn, sound.response, dark_noise_dn=2.4, variance_ratio=ratio, black_level_dn=64.0
    )
    assert not found.is_defect.any()


def test_the_long_tail_of_few_frames_is_no_defect() -> None:
    # Of 480 000 variances of 21 degrees of freedom, 2 are expected above three times the mean.
    rng = np.random.default_rng(2)
    shape = (600, 800)
    ratio = rng.chisquare(21, shape) / 21
    assert ratio.max() > 3.0
    ratio[10, 20] = 6.0
    found = correction_maps(
        64.0 + rng.normal(0, 0.1, shape),
        1 + rng.normal(0, 0.001, shape),
        dark_noise_dn=2.4,
        variance_ratio=ratio,
        black_level_dn=64.0,
    )
    assert np.argwhere(found.defects).tolist() == [[10, 20]]


def test_patterns_are_told_without_the_temporal_noise() -> None:
    rng = np.random.default_rng(8)
    noisy = maps(seed=4)
    dark = noisy.dark_dn + rng.normal(0, 0.5, MAP_SHAPE).astype(np.float32)
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
    flat = np.ones(MAP_SHAPE, np.float32)
    with pytest.raises(ValueError):
        CorrectionMaps(
            dark_dn=flat,
            response=flat[:, 1:],
            defects=np.zeros(MAP_SHAPE, np.uint8),
            black_level_dn=BLACK_DN,
        )


FOUR = {
    "schema": "standoff.noise/1",
    "gain_e_per_dn": 5.0,
    "read_noise_e": 12.0,
    "black_level_dn": 64.0,
    "frames_averaged": 10,
}


@pytest.fixture(scope="module")
def noise(tmp_path_factory: pytest.TempPathFactory) -> NoiseMeasurement:
    flickering = np.zeros(SHAPE)
    flickering[3, 50] = 5000.0
    folder = tmp_path_factory.mktemp("noise") / "s"
    return noise_of_captures(noise_session(folder, extra_variance_dn2=flickering))


def test_maps_are_read_back_to_the_bit(tmp_path: Path, noise: NoiseMeasurement) -> None:
    path = tmp_path / "noise.json"
    _write_noise_files(path, noise)
    found = read_correction(path)
    np.testing.assert_array_equal(found.dark_dn, noise.maps.dark_dn)
    np.testing.assert_array_equal(found.response, noise.maps.response)
    np.testing.assert_array_equal(np.argwhere(found.is_defect), [[3, 50]])
    assert found.black_level_dn == noise.maps.black_level_dn
    assert read_noise(path).gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-5)


def test_what_was_written_is_what_is_read(tmp_path: Path, noise: NoiseMeasurement) -> None:
    path = tmp_path / "noise.json"
    written = _write_noise_files(path, noise)
    read = read_noise(path)
    assert json_object(read) == json_object(written) == json.loads(path.read_text("utf-8"))
    assert read.capture_noise == noise.calibration.capture_noise
    assert read.gain_e_per_dn_err == noise.transfer.gain_e_per_dn_err
    assert [level.is_fitted for level in read.levels] == [True] * 7
    # When a capture was taken matters to the fit alone.
    assert "time_s" not in json_object(read)["levels"][0]


def test_a_file_of_four_figures_is_enough(tmp_path: Path) -> None:
    path = tmp_path / "noise.json"
    path.write_text(json.dumps(FOUR | {"maker": "x"}), encoding="utf-8")
    assert read_noise(path) == NoiseCalibration(
        gain_e_per_dn=5.0, read_noise_e=12.0, black_level_dn=64.0, frames_averaged=10
    )
    assert refusal(path).key == "maps"


@pytest.mark.parametrize("value", ["5", True, None, -1, [5]])
@pytest.mark.parametrize("key", ["gain_e_per_dn", "read_noise_e", "frames_averaged"])
def test_a_figure_that_is_none_is_named(tmp_path: Path, key: str, value: object) -> None:
    path = tmp_path / "noise.json"
    path.write_text(json.dumps(FOUR | {key: value}), encoding="utf-8")
    refused = refusal(path)
    assert (refused.source, refused.key) == (str(path), key)


def test_a_measurement_is_one_line_at_the_prompt(noise: NoiseMeasurement) -> None:
    assert str(noise.calibration) == repr(noise.calibration)
    assert repr(noise.calibration) in repr(noise)
    assert len(repr(noise)) < 160


def refusal(path: Path) -> NoiseFileError:
    """How the noise.json is refused by the reader of its maps."""
    with pytest.raises(NoiseFileError) as refused:
        read_correction(path)
    return refused.value


def rewritten(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document), encoding="utf-8")


@pytest.mark.parametrize("name", ["", ".", "..", "/", "a/b.tif", "../b.tif", "a\0.tif"])
def test_a_map_that_is_no_name_of_a_file_is_named(
    tmp_path: Path, noise: NoiseMeasurement, name: str
) -> None:
    path = tmp_path / "noise.json"
    _write_noise_files(path, noise)
    rewritten(path, lambda document: document["maps"]["flat"].update(file=name))
    assert refusal(path).key == "maps.flat"


def test_a_map_that_is_no_tiff_is_named_though_it_is_the_one_that_was_written(
    tmp_path: Path, noise: NoiseMeasurement
) -> None:
    path = tmp_path / "noise.json"
    _write_noise_files(path, noise)
    dark = tmp_path / "noise_dark.tif"
    data = b"no picture"
    dark.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    rewritten(path, lambda document: document["maps"]["dark"].update(sha256=digest))
    refused = refusal(path)
    assert (refused.source, refused.key) == (str(dark), "maps.dark")
    assert isinstance(refused.__cause__, TiffDamageError)


def test_maps_of_two_cameras_are_refused(tmp_path: Path, noise: NoiseMeasurement) -> None:
    path = tmp_path / "noise.json"
    _write_noise_files(path, noise)
    smaller = tmp_path / "other" / "noise.json"
    smaller.parent.mkdir()
    part = np.s_[:-1, :]
    cut = type(noise.maps)(
        dark_dn=noise.maps.dark_dn[part],
        response=noise.maps.response[part],
        defects=noise.maps.defects[part],
        black_level_dn=noise.maps.black_level_dn,
    )
    written = json_object(write_map_files(smaller, cut)["flat"])
    (tmp_path / "theirs.tif").write_bytes((smaller.parent / written["file"]).read_bytes())
    written["file"] = "theirs.tif"
    rewritten(path, lambda document: document["maps"].update(flat=written))
    refused = refusal(path)
    assert (refused.source, refused.key) == (str(path), "maps")


def test_a_folder_that_is_not_there_is_named_before_anything_is_written(
    tmp_path: Path, noise: NoiseMeasurement
) -> None:
    with pytest.raises(NoiseFileError) as refused:
        _write_noise_files(tmp_path / "nowhere" / "noise.json", noise)
    assert refused.value.source == str(tmp_path / "nowhere" / "noise_dark.tif")
    assert list(tmp_path.iterdir()) == []


def test_a_noise_json_that_cannot_be_written_is_named(
    tmp_path: Path, noise: NoiseMeasurement
) -> None:
    (tmp_path / "noise.json").mkdir()
    with pytest.raises(NoiseFileError) as refused:
        _write_noise_files(tmp_path / "noise.json", noise)
    assert refused.value.source == str(tmp_path / "noise.json")
