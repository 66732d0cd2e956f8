"""noise.json and its maps: what is written is read back, what is damaged is named."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.errors import NoiseFileError
from calibration.files import read_correction, read_noise, write_noise
from calibration.noise.captures import NoiseCalibration, measure_noise
from calibration.noise.document import write_map_files
from tests.calibration.noise_session import SHAPE, noise_session
from tests.calibration.poisson_frames import GAIN_E_PER_DN


@pytest.fixture(scope="module")
def noise(tmp_path_factory: pytest.TempPathFactory) -> NoiseCalibration:
    flickering = np.zeros(SHAPE)
    flickering[3, 50] = 5000.0
    folder = tmp_path_factory.mktemp("noise") / "s"
    return measure_noise(noise_session(folder, extra_variance_dn2=flickering))


def test_maps_are_read_back_to_the_bit(tmp_path: Path, noise: NoiseCalibration) -> None:
    path = tmp_path / "noise.json"
    write_noise(path, noise)
    found = read_correction(path)
    np.testing.assert_array_equal(found.dark_dn, noise.maps.dark_dn)
    np.testing.assert_array_equal(found.response, noise.maps.response)
    np.testing.assert_array_equal(np.argwhere(found.is_defect), [[3, 50]])
    assert found.black_level_dn == noise.maps.black_level_dn
    assert read_noise(path).gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-5)


def rewritten(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document), encoding="utf-8")


def test_a_map_that_is_no_tiff_is_named_though_it_is_the_one_that_was_written(
    tmp_path: Path, noise: NoiseCalibration
) -> None:
    path = tmp_path / "noise.json"
    file = Path(write_noise(path, noise)["maps"]["dark"]["file"])
    data = b"no picture"
    (tmp_path / file).write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    rewritten(path, lambda document: document["maps"]["dark"].update(sha256=digest))
    with pytest.raises(NoiseFileError, match=rf"{file.name}: not a readable TIFF file"):
        read_correction(path)


def test_maps_of_two_cameras_are_refused(tmp_path: Path, noise: NoiseCalibration) -> None:
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
    written = write_map_files(smaller, cut)["flat"]
    (tmp_path / "theirs.tif").write_bytes((smaller.parent / written["file"]).read_bytes())
    written["file"] = "theirs.tif"
    rewritten(path, lambda document: document["maps"].update(flat=written))
    with pytest.raises(
        NoiseFileError, match=r"noise\.json: maps of \(40, 56\), \(39, 56\) and \(40, 56\)"
    ):
        read_correction(path)


def test_a_folder_that_is_not_there_is_named_before_anything_is_written(
    tmp_path: Path, noise: NoiseCalibration
) -> None:
    with pytest.raises(NoiseFileError, match=r"cannot write .*nowhere.*: No such file"):
        write_noise(tmp_path / "nowhere" / "noise.json", noise)
    assert list(tmp_path.iterdir()) == []


def test_a_noise_json_that_cannot_be_written_is_named(
    tmp_path: Path, noise: NoiseCalibration
) -> None:
    (tmp_path / "noise.json").mkdir()
    with pytest.raises(NoiseFileError, match=r"cannot write .*noise\.json: "):
        write_noise(tmp_path / "noise.json", noise)
