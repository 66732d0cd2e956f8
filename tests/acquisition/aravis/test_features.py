"""Features by their names, and what follows when a camera changes."""

import csv
from collections import Counter
from itertools import pairwise, product
from pathlib import Path

import pytest

from acquisition.aravis.features import names_for, neutral_features
from hil_mocks.gige.features import MAKERS, Maker, features_of

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
