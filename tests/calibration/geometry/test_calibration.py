"""Geometry of the simulated bench's photographs against its truth."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.errors import GeometryError, RegistrationError
from calibration.files import read_geometry, write_geometry
from calibration.geometry import GeometryCapture
from calibration.geometry._board import CharucoBoard, find_board
from calibration.geometry._calibration import GeometryOptions, geometry_of_captures
from calibration.geometry._document import GEOMETRY_SCHEMA, GeometryCalibration
from hil_mocks.truth.render import CameraPose
from tests.calibration.geometry_bench import (
    FOCAL_PX,
    HEIGHT_PX,
    HEIGHTS_MM,
    PUPIL_MM,
    WIDTH_PX,
    captures,
    pinhole,
    truth,
)

CONTRACT = {
    "schema",
    "heights_mm",
    "scale_px_per_mm",
    "pupil_offset_mm",
    "k1",
    "k2",
    "tilt_deg",
    "axis_drift_px_per_mm",
}
BOARD_HEIGHTS_MM = (180.0, 205.0, 235.0, 275.0, 330.0)
"""From further away the markers' cells are below two of these large pixels."""
NOMINAL = GeometryOptions(nominal_focal_px=FOCAL_PX)


@pytest.fixture(scope="module")
def board_series() -> list[GeometryCapture]:
    return captures("board", BOARD_HEIGHTS_MM)


@pytest.fixture(scope="module")
def by_board(board_series: list[GeometryCapture]) -> GeometryCalibration:
    # 5 % off, as a varifocal lens may be: the board knows better.
    return geometry_of_captures(board_series, GeometryOptions(nominal_focal_px=1.05 * FOCAL_PX))


@pytest.fixture(scope="module")
def texture_series() -> list[GeometryCapture]:
    return captures("brick", tilt_x_deg=2.0)


@pytest.fixture(scope="module")
def by_texture(texture_series: list[GeometryCapture]) -> GeometryCalibration:
    return geometry_of_captures(texture_series, NOMINAL)


@pytest.mark.slow
def test_the_corners_of_a_board_are_where_the_bench_puts_them() -> None:
    nearest = captures("board", BOARD_HEIGHTS_MM[:1])[0]
    corners = find_board(nearest.image, CharucoBoard.from_text("11x8:12:9"))
    turn = np.deg2rad(4.0)
    plane = corners.plane_mm - (66.0, 48.0)
    x = np.cos(turn) * plane[:, 0] - np.sin(turn) * plane[:, 1]
    y = np.sin(turn) * plane[:, 0] + np.cos(turn) * plane[:, 1]
    seen = np.column_stack(pinhole().to_pixel(x, y, CameraPose(height_mm=BOARD_HEIGHTS_MM[0])))
    assert len(corners.seen_px) == 70
    # A hundredth of a pixel; OpenCV's own corners are 0.02 to 0.04 px off here.
    assert np.sqrt(np.mean((corners.seen_px - seen) ** 2)) < 0.01


@pytest.mark.parametrize("text", ["11x8", "11x8:12:13", "2x8:12:9", "11x8:12:9:NONE", ""])
def test_a_board_that_cannot_be_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        CharucoBoard.from_text(text)


def test_a_picture_without_a_board_is_refused() -> None:
    with pytest.raises(RegistrationError) as refused:
        find_board(np.full((100, 120), 7.0), CharucoBoard.from_text("11x8:12:9"))
    assert (refused.value.reason, refused.value.count) == ("no_board", 0)


@pytest.mark.slow
def test_a_board_gives_scale_focal_length_and_pupil(by_board: GeometryCalibration) -> None:
    # Photographs of the bench, which is flat, straight and exact.
    assert by_board.cross_validation is not None
    assert by_board.cross_validation.faults == ()
    assert by_board.scale_source == "board"
    assert by_board.focal_length_px == pytest.approx(FOCAL_PX, rel=5e-4)
    assert by_board.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.1)
    expected = [truth().scale_px_per_mm(height) for height in by_board.heights_mm]
    assert by_board.scale_px_per_mm == pytest.approx(expected, rel=5e-4)
    assert by_board.k1 == pytest.approx(-0.01, rel=0.03)


@pytest.mark.slow
def test_a_tilted_texture_gives_pupil_zooms_tilt_and_distortion(
    by_texture: GeometryCalibration,
) -> None:
    assert by_texture.scale_source == "bench"
    assert by_texture.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.1)
    assert by_texture.pupil_offset_err_mm is not None
    assert abs(by_texture.pupil_offset_mm - PUPIL_MM) < 4 * by_texture.pupil_offset_err_mm
    for near in HEIGHTS_MM:
        for far in HEIGHTS_MM:
            assert by_texture.zoom(near, far) == pytest.approx(truth().zoom(near, far), rel=1e-4)
    assert by_texture.k1 == pytest.approx(-0.01, rel=0.05)
    assert by_texture.tilt_x_deg == pytest.approx(2.0, abs=0.05)
    assert by_texture.tilt_y_deg == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
def test_a_vertical_stage_under_a_tilted_camera_drifts_by_the_tilt(
    by_texture: GeometryCalibration,
) -> None:
    # Closed form: the stage pierces the image f tan(tilt) from the axis; over the distance.
    expected = -FOCAL_PX * np.tan(np.deg2rad(2.0)) / (HEIGHTS_MM[0] + PUPIL_MM)
    assert by_texture.axis_drift_x_px_per_mm == pytest.approx(expected, abs=2e-3)
    assert by_texture.axis_drift_y_px_per_mm == pytest.approx(0.0, abs=2e-3)


@pytest.mark.slow
def test_what_is_written_is_read_back(by_texture: GeometryCalibration, tmp_path: Path) -> None:
    path = tmp_path / "geometry.json"
    write_geometry(path, by_texture)
    document = json.loads(path.read_text("utf-8"))
    assert document.keys() >= CONTRACT
    assert document["schema"] == GEOMETRY_SCHEMA
    assert document["heights_mm"] == list(HEIGHTS_MM)
    assert read_geometry(path) == by_texture
    # The file says the zooms, too.
    for pair in by_texture.zooms:
        assert pair.zoom == by_texture.zoom(pair.near_height_mm, pair.far_height_mm)
    # OpenCV's k1 by its definition: at the corner it must move a point as ours does.
    corner = np.hypot(WIDTH_PX - 1, HEIGHT_PX - 1) / 2 / FOCAL_PX
    assert document["k1_opencv"] * corner**2 == pytest.approx(by_texture.k1, rel=1e-9)


@pytest.mark.slow
def test_a_wrong_height_is_named_and_left_out(board_series: list[GeometryCapture]) -> None:
    spoilt = list(board_series)
    spoilt[2] = replace(spoilt[2], height_mm=spoilt[2].height_mm + 1.5)
    found = geometry_of_captures(spoilt)
    [excluded] = found.excluded
    assert excluded.image == spoilt[2].name
    assert "235" in excluded.reason
    assert found.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.1)


@pytest.mark.slow
def test_a_moved_target_is_named_and_left_out(board_series: list[GeometryCapture]) -> None:
    spoilt = list(board_series)
    moved = np.roll(spoilt[3].image, 9, axis=1)
    spoilt[3] = replace(spoilt[3], image=moved)
    found = geometry_of_captures(spoilt)
    [excluded] = found.excluded
    assert excluded.image == spoilt[3].name
    assert "moved" in excluded.reason


@pytest.mark.slow
def test_another_target_among_the_captures_is_named_and_left_out(
    texture_series: list[GeometryCapture],
) -> None:
    spoilt = list(texture_series)
    spoilt[1] = replace(spoilt[1], image=captures("gravel", HEIGHTS_MM[1:2])[0].image)
    found = geometry_of_captures(spoilt, NOMINAL)
    assert [one.image for one in found.excluded] == [spoilt[1].name]
    assert found.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.1)


def test_captures_at_one_height_are_refused_with_the_remedy() -> None:
    image = np.zeros((60, 80))
    flat = [
        GeometryCapture(
            name=f"{n}.tif", kind="texture", target="t", orientation_deg=0.0,
            height_mm=0.0, image=image,
        )
        for n in range(3)
    ]  # fmt: skip
    with pytest.raises(GeometryError) as refused:
        geometry_of_captures(flat)
    assert refused.value.reason == "one_height"


def test_captures_without_texture_are_refused_by_name() -> None:
    rng = np.random.default_rng(0)
    flat = [
        GeometryCapture(
            name=f"{n}.tif", kind="texture", target="t", orientation_deg=0.0,
            height_mm=100.0 + n, image=1000 + rng.normal(0, 1e-3, (60, 80)) + np.arange(80),
        )
        for n in range(3)
    ]  # fmt: skip
    with pytest.raises(GeometryError) as refused:
        geometry_of_captures(flat)
    assert (refused.value.reason, refused.value.subject) == ("not_matched", "0.tif")
