"""Features by their names, and what follows when a camera changes."""

import csv
from collections import Counter
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import pytest

from acquisition.aravis._camera import _require_same_camera
from acquisition.aravis._features import names_for, neutral_features
from acquisition.devices import CameraSettings, DeviceInfo
from acquisition.errors import CameraFeatureError
from hil_mocks.gige._features import MAKERS, Maker, features_of
from tests.acquisition.fakes import SETTINGS

INFO = DeviceInfo(vendor="V", model="M", serial_number="S1", firmware="1", driver="aravis")


def test_the_same_camera_set_the_same_passes() -> None:
    nearly = replace(SETTINGS, exposure_us=SETTINGS.exposure_us * (1 + 1e-9))
    _require_same_camera(INFO, INFO, SETTINGS, nearly)


@pytest.mark.parametrize(
    ("changes", "feature"),
    [
        ({"exposure_us": 2001.0}, "ExposureTime"),
        ({"gain_db": 1.0}, "Gain"),
        ({"width_px": 8}, "Width"),
        ({"pixel_format": "Mono8"}, "PixelFormat"),
        ({"frame_rate_hz": 49.0}, "AcquisitionFrameRate"),
        ({"features": {"Gamma": 0.5}}, "Gamma"),
        ({"features": {}}, "Gamma"),
        ({"features": {"Gamma": 1.0, "LUTEnable": True}}, "LUTEnable"),
    ],
)
def test_a_setting_that_differs_is_named(changes: dict[str, object], feature: str) -> None:
    now: CameraSettings = replace(SETTINGS, **changes)  # type: ignore[arg-type]  # by table
    with pytest.raises(CameraFeatureError) as caught:
        _require_same_camera(INFO, INFO, SETTINGS, now)
    assert caught.value.feature == feature


def test_another_camera_at_the_same_address_is_named() -> None:
    other = replace(INFO, serial_number="S2")
    with pytest.raises(CameraFeatureError) as refused:
        _require_same_camera(INFO, other, SETTINGS, SETTINGS)
    assert refused.value.feature == "DeviceSerialNumber"


ROOT = Path(__file__).parents[3]
TABLE = (ROOT / "acquisition/aravis/feature_names.csv").read_text("utf-8")
NAMES = [row["name"] for row in csv.DictReader(TABLE.splitlines())]


def test_every_name_of_the_table_is_in_the_guide() -> None:
    guide = (ROOT / "docs/camera-features.md").read_text("utf-8")
    assert [name for name in NAMES if f"`{name}`" not in guide] == []


def test_a_row_with_a_maker_comes_before_the_same_name_for_all() -> None:
    units = {
        camera: next(row.unit for row in names_for("gain", camera) if row.name == "Gain")
        for camera in (
            "Allied Vision Technologies Manta_G-046B",
            "Basler acA1300-60gm",
            "FLIR Blackfly S BFS-PGE-31S4M",
            "Teledyne DALSA Nano-M1920",
            "Hikrobot MV-CA050-10GM",
            "IDS Imaging Development Systems GmbH GV-5040CP",
            "Kids Vision 1",
        )
    }
    assert list(units.values()) == ["dB", "dB", "dB", "factor", "dB", "factor", "counts"]


def test_a_feature_has_one_neutral_value_for_each_camera() -> None:
    for camera in ("Basler ace", "Allied Vision Manta", "FLIR Blackfly", "IDS", "Other"):
        counts = Counter(row.name for row in neutral_features(camera))
        assert [name for name, count in counts.items() if count > 1] == []


@pytest.mark.parametrize(("maker", "is_colour"), [*product(MAKERS, (False, True))])
def test_a_simulated_cameras_registers_do_not_overlap(maker: Maker, is_colour: bool) -> None:
    features = features_of("RG" if is_colour else None, has_temperature=True, maker=maker)
    spans = sorted(
        (feature.address, feature.address + feature.length)
        for feature in features
        if feature.bits is None and feature.chunk_id is None
    )
    assert all(end <= start for (_, end), (start, _) in pairwise(spans))
    assert len({feature.name for feature in features}) == len(features)
