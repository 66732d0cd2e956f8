"""noise.json and its maps: what is written is read back, what is damaged is named."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.untrusted import TiffDamageError
from calibration.documents import json_object
from calibration.errors import NoiseFileError
from calibration.files import read_correction, read_noise, write_noise
from calibration.noise import NoiseCalibration, NoiseMeasurement, measure_noise, write_map_files
from tests.calibration.noise_session import SHAPE, noise_session
from tests.calibration.poisson_frames import GAIN_E_PER_DN

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
    return measure_noise(noise_session(folder, extra_variance_dn2=flickering))


def test_maps_are_read_back_to_the_bit(tmp_path: Path, noise: NoiseMeasurement) -> None:
    path = tmp_path / "noise.json"
    write_noise(path, noise)
    found = read_correction(path)
    np.testing.assert_array_equal(found.dark_dn, noise.maps.dark_dn)
    np.testing.assert_array_equal(found.response, noise.maps.response)
    np.testing.assert_array_equal(np.argwhere(found.is_defect), [[3, 50]])
    assert found.black_level_dn == noise.maps.black_level_dn
    assert read_noise(path).gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-5)


def test_what_was_written_is_what_is_read(tmp_path: Path, noise: NoiseMeasurement) -> None:
    path = tmp_path / "noise.json"
    written = write_noise(path, noise)
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
    write_noise(path, noise)
    rewritten(path, lambda document: document["maps"]["flat"].update(file=name))
    assert refusal(path).key == "maps.flat"


def test_a_map_that_is_no_tiff_is_named_though_it_is_the_one_that_was_written(
    tmp_path: Path, noise: NoiseMeasurement
) -> None:
    path = tmp_path / "noise.json"
    write_noise(path, noise)
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
    write_noise(path, noise)
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
        write_noise(tmp_path / "nowhere" / "noise.json", noise)
    assert refused.value.source == str(tmp_path / "nowhere" / "noise_dark.tif")
    assert list(tmp_path.iterdir()) == []


def test_a_noise_json_that_cannot_be_written_is_named(
    tmp_path: Path, noise: NoiseMeasurement
) -> None:
    (tmp_path / "noise.json").mkdir()
    with pytest.raises(NoiseFileError) as refused:
        write_noise(tmp_path / "noise.json", noise)
    assert refused.value.source == str(tmp_path / "noise.json")
