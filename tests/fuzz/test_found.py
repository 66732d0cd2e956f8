"""Inputs that once came out as another error than the documented one: found by fuzzing."""

import json
import os
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.bench import load_bench, parse_overrides
from acquisition.errors import BenchConfigError, PlanError, SessionError
from acquisition.plan import load_plan
from acquisition.session._journal import _read_journal
from acquisition.session._record import Manifest
from acquisition.untrusted import TiffDamageError, parse_json, parse_toml, read_tiff
from analysis.changes import ChangeOptions, changes_between
from analysis.errors import AnalysisError
from calibration.errors import NoiseFileError, PsfFileError, RegistrationError
from calibration.files import read_noise, read_psf
from calibration.registration import DistortedPose, RegistrationHints, register_images
from simulation import GaussianPsf, simulate_pose_of_image
from simulation.arguments import ArgumentError
from simulation.capture_noise import CaptureNoise
from standoff.errors import ImageFileError
from standoff.library.registration import read_points
from tests.acquisition.session_fixtures import writer
from tests.fuzz.damage import DEEP
from tests.fuzz.result_targets import (
    MAPS,
    NOISE,
    damaged_map,
    read_kernel,
    read_segment,
    segment_of,
    sound_psf,
)
from tests.fuzz.wire_targets import into_zaber
from tests.standoff.changed_photographs import FAR, NEAR, ZOOM, changed_pair

THOUSANDS_OF_DIGITS = "9" * 5000


def test_brackets_without_end_are_no_json_and_no_toml() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json(DEEP)
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml(f"a = {DEEP}")


@pytest.mark.parametrize("text", ["\\ud800", "a\\uDFFF", "\\ude00\\ud83d"])
def test_half_a_character_is_no_json(text: str) -> None:
    with pytest.raises(ValueError, match="half a character"):
        parse_json(f'{{"followup": "{text}"}}')
    whole = "\\ud83d\\ude00 \\\\ud800"
    assert parse_json(f'["{whole}"]') == ["😀 \\ud800"]
    with pytest.raises(ValueError, match="half a character"):
        parse_json(f'{{"followup": "{text}"}}', has_file_names=True)


def test_the_name_of_a_file_need_not_be_utf_8() -> None:
    name = os.fsdecode(b"scene\x80.tif")
    text = json.dumps([name])
    assert parse_json(text, has_file_names=True) == [name]
    with pytest.raises(ValueError, match="half a character"):
        parse_json(text)


def test_a_session_file_of_brackets_is_damaged() -> None:
    with pytest.raises(SessionError, match="damaged"):
        Manifest.from_bytes(DEEP.encode(), source="session.json")
    with pytest.raises(SessionError, match="line 1: damaged"):
        _read_journal(DEEP.encode() + b"\n{}\n")


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


@pytest.mark.parametrize("value", [1e-300, 1e300, -1e300, 3e38])
@pytest.mark.parametrize("key", ["gain_e_per_dn", "read_noise_e", "black_level_dn"])
def test_noise_of_no_camera_is_refused_by_name(tmp_path: Path, key: str, value: float) -> None:
    path = tmp_path / "noise.json"
    path.write_text(json.dumps(NOISE | {key: value}))
    if value == 1e-300 and key != "gain_e_per_dn":
        read_noise(path)
        return
    with pytest.raises(NoiseFileError, match=key):
        read_noise(path)


def test_noise_that_hides_everything_leaves_nothing_to_compare() -> None:
    with pytest.raises(ArgumentError, match="black_level_dn"):
        CaptureNoise(gain_e_per_dn=5.0, read_noise_e=12.0, black_level_dn=-1e300)
    noise = CaptureNoise(gain_e_per_dn=1e-9, read_noise_e=1e6, black_level_dn=-1e12)
    pair = changed_pair(1, 25.0)
    pose = DistortedPose(
        matrix=np.diag([ZOOM, ZOOM, 1.0]), k1=0.0, reference_shape=NEAR, followup_shape=FAR
    )
    with np.errstate(all="ignore"), pytest.raises(AnalysisError, match="nothing in common"):
        changes_between(
            pair.reference, pair.followup, options=ChangeOptions(pose=pose, noise=noise)
        )


@pytest.mark.parametrize("value", [3e38, None, "text", []])
@pytest.mark.parametrize(
    "key", ["devices.camera", "devices.lens", "bench.camera", "bench.stage", "bench.capture"]
)
def test_a_part_of_a_session_that_is_no_table_is_refused_by_name(
    tmp_path: Path, key: str, value: object
) -> None:
    writer(tmp_path / "s").close()
    document = json.loads((tmp_path / "s" / "session.json").read_bytes())
    part, _, name = key.partition(".")
    document[part][name] = value
    with pytest.raises(SessionError, match=rf"{key} is not a table"):
        Manifest.from_bytes(json.dumps(document).encode(), source="session.json")


@pytest.mark.parametrize("name", ["freq_cy_per_px", "mtf", "mtf_err"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_curve_of_unequal_lengths_is_refused_by_name(
    tmp_path: Path, axis: str, name: str
) -> None:
    document = deepcopy(sound_psf())
    del document["transfer"][axis][name][25]
    (tmp_path / "psf.json").write_text(json.dumps(document))
    with pytest.raises(PsfFileError, match=rf"transfer\.{axis}: mtf.* must have \d+ numbers"):
        read_psf(tmp_path / "psf.json")


@pytest.mark.parametrize(
    ("row", "column", "value"),
    [(1, 1, 2**31), (1, 1, -1e300), (2, 2, 2**63), (0, 1, 2**31), (1, 0, 3e38)],
)
@pytest.mark.parametrize("side", [0, 1])
def test_a_pose_at_which_a_pixel_covers_the_photograph_leaves_nothing_in_common(
    row: int, column: int, value: float, side: int
) -> None:
    matrix = np.eye(3)
    matrix[row, column] = value
    photographs = [np.random.default_rng(seed).normal(size=(64, 80)) for seed in (1, 2)]

    def register_at_it() -> None:
        hints = RegistrationHints(matrix=matrix)
        register_images(photographs[side], photographs[1 - side], hints=hints)

    with np.errstate(all="ignore"), pytest.raises((RegistrationError, ArgumentError)):
        register_at_it()


def test_a_singular_pose_of_any_size_is_refused_without_a_warning() -> None:
    image = np.random.default_rng(1).normal(size=(40, 50))
    psf = GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.7)
    for row, column in ((1, 0), (2, 0)):
        matrix = np.eye(3)
        matrix[row, column] = 1e300
        with pytest.raises(ValueError, match="singular"):
            simulate_pose_of_image(image, matrix, (30, 20), psf)
    small, large = (
        simulate_pose_of_image(image, scale * np.diag([1.5, 1.5, 1.0]), (30, 20), psf)
        for scale in (1.0, 2.0**1000)
    )
    assert np.array_equal(small.image, large.image)


def test_a_table_of_points_beyond_its_size_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.touch()
    os.truncate(path, 60_000_000)
    with pytest.raises(ImageFileError, match="at most 16 MiB are read"):
        read_points(path)


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


@pytest.mark.parametrize(
    "line", [b'{"key": "\xf5"}\n', DEEP.encode(), b"[]", b'{"key": 1e999}', b""]
)
def test_a_record_of_a_sweep_that_is_none_is_not_there(tmp_path: Path, line: bytes) -> None:
    (tmp_path / "0.records").write_bytes(segment_of(line))
    assert read_segment(tmp_path / "0.records") == []


def test_digits_of_other_scripts_are_no_zaber_address() -> None:
    into_zaber("/²1 1 07 home\n".encode("latin-1"))
    into_zaber(f"/{THOUSANDS_OF_DIGITS} 1 07 home\n".encode())
