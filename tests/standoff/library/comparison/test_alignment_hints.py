"""What an operator says of a pair: tables of points, masks, homographies, levels of clipping."""

import csv
import json
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from PIL import Image

from acquisition.photographs._encoding import LINEAR, SRGB
from acquisition.photographs._photograph import Photograph
from calibration.errors import CalibrationError
from calibration.registration._features import POINT_COLUMNS
from standoff.errors import ApplicationError, HintError
from standoff.library.registration import (
    AlignmentHints,
    alignment_hints,
    read_mask,
    read_points,
)

NEAR, FAR = (300, 400), (150, 200)
SQUARE = [(10, 20, 110, 120), (90, 20, 190, 120), (10, 80, 110, 180), (90, 80, 190.5, 180)]


def table(
    path: Path, rows: Sequence[tuple[float, ...]], header: str = ",".join(POINT_COLUMNS)
) -> Path:
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def hints_of(**files: Path) -> AlignmentHints:
    hints = alignment_hints(**files)  # type: ignore[arg-type]  # a path for each
    assert hints is not None
    return hints


def test_points_are_read_by_the_names_of_their_columns(tmp_path: Path) -> None:
    points = read_points(table(tmp_path / "p.csv", SQUARE))
    np.testing.assert_array_equal(points.followup_px[3], [90, 80])
    np.testing.assert_array_equal(points.reference_px[3], [190.5, 180])
    other = tmp_path / "other.csv"
    with other.open("w", encoding="utf-8-sig", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["name", *POINT_COLUMNS[::-1]])
        writer.writerows(["corner", *row[::-1]] for row in SQUARE)
    again = read_points(other)
    np.testing.assert_array_equal(again.followup_px, points.followup_px)
    np.testing.assert_array_equal(again.reference_px, points.reference_px)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no column followup_x_px; the first line must be followup_x_px,followup_y_px,"),
        ("a_x_px,a_y_px,b_x_px,b_y_px\n1,2,3,4\n", "no column followup_x_px"),
        ("10,20,110,120\n" * 5, "no column followup_x_px"),
        (
            f"{','.join(POINT_COLUMNS)}\n1,2,3,4\n" * 1,
            "1 distinct pairs of points; mark at least 4",
        ),
        (f"{','.join(POINT_COLUMNS)}\n" + "1,2,3,4\n" * 9, "1 distinct pairs of points"),
        (
            f"{','.join(POINT_COLUMNS)}\n1,2,3,4\n5,x,7,8\n",
            "line 3: followup_y_px 'x' is no number",
        ),
        (f"{','.join(POINT_COLUMNS)}\n1,2,3\n", "line 2: reference_y_px is missing"),
        (f"{','.join(POINT_COLUMNS)}\n1,2,nan,4\n", "reference_x_px 'nan' is no number"),
        (f"{','.join(POINT_COLUMNS)}\n1,2,1e999,4\n", "'1e999' is no number"),
        ("\0\0\0", "no column"),
    ],
)
def test_a_table_of_something_else_is_told_in_one_line(
    tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "p.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HintError) as refused:
        read_points(path)
    assert said in str(refused.value)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


NUMBERS = st.one_of(
    st.floats().map(str), st.text(max_size=6), st.sampled_from(["1", "2.5", "-3", '"', ",", "\n"])
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.lists(NUMBERS, max_size=6), max_size=8), st.booleans())
def test_no_table_does_anything_but_be_read_or_refused(
    tmp_path: Path, cells: list[list[str]], has_header: bool
) -> None:
    text = StringIO(newline="")
    writer = csv.writer(text, quoting=csv.QUOTE_MINIMAL, escapechar="\\")
    if has_header:
        writer.writerow(POINT_COLUMNS)
    writer.writerows(cells)
    path = tmp_path / "p.csv"
    path.write_bytes(text.getvalue().encode("utf-8", "surrogatepass"))
    try:
        points = read_points(path)
    except ApplicationError:
        return
    assert has_header
    assert points.followup_px.shape == points.reference_px.shape
    assert np.isfinite([points.followup_px, points.reference_px]).all()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200), st.sampled_from(["p.csv", "H.json", "mask.png"]))
def test_no_bytes_do_anything_but_be_read_or_refused(
    tmp_path: Path, data: bytes, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    kind = {"p.csv": "points", "H.json": "homography", "mask.png": "mask"}[name]
    with pytest.raises((ApplicationError, CalibrationError)):
        hints_of(**{kind: path})


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, 10_000), value=st.integers(0, 255))
def test_a_damaged_mask_is_read_or_refused(tmp_path: Path, at: int, value: int) -> None:
    path = tmp_path / "mask.png"
    picture = np.zeros((12, 16), np.uint8)
    picture[3:6, 4:9] = 255
    Image.fromarray(picture).save(path)
    data = bytearray(path.read_bytes())
    data[at % len(data)] = value
    path.write_bytes(data)
    try:
        left_out = read_mask(path)
    except ApplicationError:
        return
    assert left_out.dtype == np.bool_


@pytest.mark.parametrize("mode", ["L", "1", "RGB", "RGBA", "P"])
def test_what_is_not_black_is_left_out_in_any_kind_of_picture(tmp_path: Path, mode: str) -> None:
    picture = np.zeros((12, 16), np.uint8)
    picture[3:6, 4:9] = 255
    Image.fromarray(picture).convert(mode).save(tmp_path / "mask.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png"), picture > 0)


def test_a_mask_that_leaves_nothing_to_compare_is_refused(tmp_path: Path) -> None:
    Image.fromarray(np.full((12, 16), 7, np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(HintError, match="leaves out every pixel"):
        read_mask(tmp_path / "mask.png")


def test_hints_of_another_size_name_both_sizes(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((150, 201), np.uint8)).save(tmp_path / "mask.png")
    masked = hints_of(mask=tmp_path / "mask.png")
    with pytest.raises(HintError, match=r"mask.png: 201 x 150 px, but far.tif has 200 x 150"):
        masked.of_pair(NEAR, FAR, "far.tif")
    document = {"schema": "standoff.homography/1", "matrix": np.eye(3).tolist(), "size": [640, 480]}
    (tmp_path / "H.json").write_text(json.dumps(document))
    posed = hints_of(homography=tmp_path / "H.json")
    with pytest.raises(HintError, match=r"H.json: for follow-ups of 640 x 480 px, but far.tif"):
        posed.of_pair(NEAR, FAR, "far.tif")
    assert posed.of_pair(NEAR, (480, 640), "far.tif") is not None


@pytest.mark.parametrize(
    ("point", "where"), [((250, 20, 110, 120), "far.tif"), ((90, 20, 110, 300), "the reference")]
)
def test_a_point_outside_its_photograph_is_named(
    tmp_path: Path, point: tuple[float, ...], where: str
) -> None:
    hints = hints_of(points=table(tmp_path / "p.csv", [*SQUARE, point]))
    with pytest.raises(HintError, match=f"lies outside {where}"):
        hints.of_pair(NEAR, FAR, "far.tif")


def test_without_hints_there_are_none() -> None:
    assert AlignmentHints().of_pair(NEAR, FAR, "far.tif") is None


def test_the_level_of_clipping_is_that_of_the_light() -> None:
    grey = np.array([[0, 128, 255]], np.uint8)
    linear = Photograph(path=Path("a"), stored=grey, full_scale_dn=255.0, saturation_dn=255.0)
    assert linear.white_level_dn(None) == 255
    assert linear.white_level_dn(240) == 240
    encoded = Photograph(path=Path("b"), stored=grey, full_scale_dn=255.0, encoding=SRGB)
    # IEC 61966-2-1: ((240 / 255 + 0.055) / 1.055)^2.4 of white.
    assert encoded.white_level_dn(240) == pytest.approx(
        255 * ((240 / 255 + 0.055) / 1.055) ** 2.4, rel=1e-6
    )
    with pytest.raises(ApplicationError, match="no level 300; its levels end at 255"):
        linear.white_level_dn(300)
    floats = Photograph(path=Path("c"), stored=grey.astype(np.float32), encoding=LINEAR)
    assert floats.white_level_dn(None) is None
    assert floats.white_level_dn(300) == 300
