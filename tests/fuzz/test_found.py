"""Inputs that once came out as another error than the documented one: found by fuzzing."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.bench import load_bench, parse_overrides
from acquisition.errors import BenchConfigError, PlanError, SessionError
from acquisition.plan import load_plan
from acquisition.session.journal_reading import read_journal
from acquisition.session.manifest import Manifest
from acquisition.untrusted import TiffDamageError, parse_json, parse_toml, read_tiff
from calibration.errors import NoiseFileError
from calibration.files import read_noise
from standoff.workflows.sr_dataset.record import ShardRecord
from tests.fuzz.damage import DEEP
from tests.fuzz.result_targets import MAPS, NOISE, damaged_map, read_kernel
from tests.fuzz.wire_targets import into_zaber

THOUSANDS_OF_DIGITS = "9" * 5000


def test_brackets_without_end_are_no_json_and_no_toml() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json(DEEP)
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml(f"a = {DEEP}")


def test_a_session_file_of_brackets_is_damaged() -> None:
    with pytest.raises(SessionError, match="damaged"):
        Manifest.from_bytes(DEEP.encode(), source="session.json")
    with pytest.raises(SessionError, match="line 1: damaged"):
        read_journal(DEEP.encode() + b"\n{}\n")


@pytest.mark.parametrize("value", [DEEP, THOUSANDS_OF_DIGITS])
def test_a_toml_value_beyond_the_parser_names_the_file(tmp_path: Path, value: str) -> None:
    path = tmp_path / "f.toml"
    path.write_text(f"a = {value}")
    with pytest.raises(BenchConfigError, match=r"f\.toml: not valid TOML"):
        load_bench(path)
    with pytest.raises(PlanError, match=r"f\.toml"):
        load_plan(path)
    # On the command line what is no TOML is text.
    assert parse_overrides([f"stage.port={value}"]) == {"stage.port": value}


def test_a_section_that_is_no_table_takes_no_key(tmp_path: Path) -> None:
    path = tmp_path / "b.toml"
    path.write_text("camera = 1")
    with pytest.raises(BenchConfigError, match="camera is not a table"):
        load_bench(path, {"camera.gain_db": 1.0})


@pytest.mark.parametrize("value", ["1" + "0" * 400, "Infinity", "NaN"])
@pytest.mark.parametrize("key", ["gain_e_per_dn", "frames_averaged"])
def test_a_number_that_is_none_is_refused_by_name(tmp_path: Path, key: str, value: str) -> None:
    path = tmp_path / "noise.json"
    path.write_text(json.dumps(NOISE | {key: "?"}).replace('"?"', value))
    with pytest.raises(NoiseFileError, match=key):
        read_noise(path)


def test_a_damaged_map_is_named_though_its_sum_is_right() -> None:
    for data in (b"", b"II*\0", MAPS["noise-dark.tif"][:150]):
        with pytest.raises(NoiseFileError, match=r"noise-dark\.tif: not a readable TIFF"):
            damaged_map(data)


def test_a_page_that_claims_more_pixels_than_any_file_of_its_size_holds(tmp_path: Path) -> None:
    path = tmp_path / "huge.tif"
    tifffile.imwrite(path, np.zeros((4, 5), np.float32))
    with tifffile.TiffFile(path, mode="r+") as tiff:
        for name in ("ImageWidth", "ImageLength"):
            tiff.pages.first.tags[name].overwrite(60_000)
    with pytest.raises(TiffDamageError, match="a page of"):
        read_tiff(path.read_bytes())


def test_a_kernel_with_a_damaged_header_counts_as_none() -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (13, 13), "
    assert read_kernel(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header) is None


@pytest.mark.parametrize("data", [b'{"key": "\xf5"}\n', DEEP.encode(), b"[]", b'{"key": 1e999}'])
def test_a_record_of_pairs_that_is_none_is_not_there(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "0.json").write_bytes(data)
    assert ShardRecord.read(tmp_path / "0.json") is None


def test_digits_of_other_scripts_are_no_zaber_address() -> None:
    into_zaber("/²1 1 07 home\n".encode("latin-1"))
    into_zaber(f"/{THOUSANDS_OF_DIGITS} 1 07 home\n".encode())
