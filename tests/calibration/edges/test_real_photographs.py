"""Edges that real cameras photographed: tests/data, whose README says where they are from."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from acquisition.photographs import luma_plane
from calibration.edges import (
    EdgeImage,
    EdgeMeasurement,
    JpegCompression,
    Method,
    edges_of_image,
    gaussian_mtf50,
)
from calibration.edges.measurement import _told_apart
from calibration.psf import PsfCalibration, psf_of_images
from simulation.arrays import FloatArray

FOLDER = Path(__file__).parents[2] / "data"

# Three independent estimators agree on this width of the photographed slanted edge: maximum
# likelihood on raw pixels, a P-spline and MTF Mapper.
TOTAL_SIGMA_PX = 0.935


def calibrated(name: str, method: Method = "all-angles") -> PsfCalibration:
    image = luma_plane(tifffile.imread(FOLDER / "edges" / name))
    return psf_of_images([EdgeImage(name=name, image_dn=image, saturation_dn=255.0)], method=method)


def test_the_photographed_vertical_edge_gives_sigma_x_alone() -> None:
    psf = calibrated("v_edge.tif")
    assert psf.sigma_x_px == pytest.approx(TOTAL_SIGMA_PX, abs=0.005)
    assert psf.sigma_y_px is None
    assert psf.rho is None


def test_the_photographed_horizontal_edge_gives_sigma_y_alone() -> None:
    psf = calibrated("h_edge.tif")
    assert psf.sigma_y_px == pytest.approx(TOTAL_SIGMA_PX, abs=0.005)
    assert psf.sigma_x_px is None
    assert psf.rho is None


def test_the_papers_way_gives_what_binning_with_an_lsf_fit_gave_elsewhere() -> None:
    psf = calibrated("v_edge.tif", "paper")
    # An independent program, binning and fitting the line spread function: 0.981 px.
    assert psf.sigma_x_px == pytest.approx(0.981, abs=0.003)


def test_the_measured_contrast_of_the_photographed_edge_is_near_that_of_its_gaussian() -> None:
    for edge in calibrated("v_edge.tif").edges:
        assert edge.esfr is not None
        # The profile is flagged as not quite Gaussian: 2 %.
        assert edge.esfr.mtf50_cy_per_px == pytest.approx(gaussian_mtf50(TOTAL_SIGMA_PX), rel=0.02)


def photographed(path: Path) -> EdgeImage:
    """A JPEG read as linear, with how it was compressed."""
    with Image.open(path) as opened:
        steps = np.array(opened.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]  # JPEG's own
        image = np.asarray(opened, dtype=np.float64)
    return EdgeImage(
        name=path.name,
        image_dn=image,
        saturation_dn=255.0,
        is_jpeg=True,
        compression=JpegCompression(steps=steps, code_levels_dn=np.arange(256.0)),
    )


@cache
def calibrated_by(path: Path) -> PsfCalibration:
    return psf_of_images([photographed(path)])


@pytest.mark.slow
def test_no_photographed_chessboard_is_wider_or_narrower_than_another_program_found_any() -> None:
    for path in sorted((FOLDER / "chessboards").glob("*.jpg")):
        psf = calibrated_by(path)
        assert psf.sigma_x_px is not None, path.name
        assert psf.sigma_y_px is not None, path.name
        # Medians of single photographs: 0.76 to 1.00 and 0.67 to 0.94. The board is tilted, near
        # parts of it are sharper: this is their mean.
        assert 0.72 < psf.sigma_x_px < 1.05, path.name
        assert 0.64 < psf.sigma_y_px < 0.99, path.name
        # The edges run in about two directions; what those do not tell does not turn the transfer.
        # The lens is no Gaussian, which may move its MTF50 by a quarter; turned, one was 60 % off.
        assert psf.transfer_2d is not None, path.name
        for angle_deg, sigma_px in ((0.0, psf.sigma_x_px), (90.0, psf.sigma_y_px)):
            mtf50 = psf.transfer_2d.mtf50_cy_per_px(angle_deg)
            assert mtf50 == pytest.approx(1.06 * gaussian_mtf50(sigma_px), rel=0.2), path.name


@pytest.mark.slow
@pytest.mark.parametrize("knows_steps", [False, True])
def test_photographed_chessboards_give_their_widths_and_sixty_edges_each(
    knows_steps: bool,
) -> None:
    widths: dict[str, list[float]] = {"vertical": [], "horizontal": [], "diagonal": []}
    for path in sorted((FOLDER / "chessboards").glob("*.jpg")):
        if knows_steps:
            edges: Sequence[EdgeMeasurement] = calibrated_by(path).edges
        else:
            edges = edges_of_image(replace(photographed(path), compression=None))
        used = [edge for edge in edges if edge.is_used]
        assert len(used) >= 60, path.name
        for edge in used:
            widths[edge.orientation].append(edge.sigma_px)
    # Medians over all photographs by another program; single ones lie between 0.67 and 1.00.
    assert np.median(widths["vertical"]) == pytest.approx(0.85, rel=0.05)
    assert np.median(widths["horizontal"]) == pytest.approx(0.79, rel=0.05)


LEAST_SIDE_PX = 22.0
UNSEEN_MOST = 0.05  # of the contrast: how far a level may lie outside those of the pixels
CLIPPED_MOST = 0.1  # where the pixels are at the end of the scale: they tell a bound


def board_sides(image_dn: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Sides of 22 px or more between neighbouring inner corners, each from corner to corner."""
    found, corners = cv2.findChessboardCorners(image_dn.astype(np.uint8), (9, 6))
    assert found
    grid = np.asarray(corners, dtype=np.float64).reshape(6, 9, 2)
    pairs = [
        (grid[row, col], grid[row + down, col + right])
        for row in range(6)
        for col in range(9)
        for down, right in ((0, 1), (1, 0))
        if row + down < 6 and col + right < 9
    ]
    return [(a, b) for a, b in pairs if np.hypot(*(b - a)) >= LEAST_SIDE_PX]


def lies_on(edge: EdgeMeasurement, side: tuple[FloatArray, FloatArray]) -> bool:
    """Whether the middle of the edge is within the side, 1.5 px from it at most, and parallel."""
    first, last = side
    length = float(np.hypot(*(last - first)))
    along = (last - first) / length
    dx, dy = np.array([edge.x_px, edge.y_px]) - first
    turned = edge.angle_deg - np.rad2deg(np.arctan2(along[1], along[0]))
    return bool(
        0.1 * length < along[0] * dx + along[1] * dy < 0.9 * length
        and abs(along[0] * dy - along[1] * dx) < 1.5
        and abs((turned + 90.0) % 180.0 - 90.0) < 4.0
    )


def is_among_the_pixels(edge: EdgeMeasurement, image_dn: FloatArray) -> bool:
    """Whether the edge's levels are those of pixels within the reach of its fit."""
    reach = int(np.ceil(6 * edge.sigma_px + 4 + edge.length_px / 2))
    row, col = round(edge.y_px), round(edge.x_px)
    own = image_dn[max(row - reach, 0) : row + reach + 1, max(col - reach, 0) : col + reach + 1]
    assert edge.levels_dn is not None
    low, high = edge.levels_dn
    below = CLIPPED_MOST if own.min() <= 0 else UNSEEN_MOST
    above = CLIPPED_MOST if own.max() >= 255 else UNSEEN_MOST
    contrast = high - low
    return bool(low >= own.min() - below * contrast and high <= own.max() + above * contrast)


def linear_from_srgb(levels: FloatArray) -> FloatArray:
    """IEC 61966-2-1, from 0 to 255."""
    v = levels / 255.0
    return 255.0 * np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


@pytest.mark.slow
@pytest.mark.parametrize("is_srgb", [False, True])
def test_every_side_of_the_chessboards_is_measured_and_told_from_the_room(is_srgb: bool) -> None:
    count = measured = beside = 0
    for path in sorted((FOLDER / "chessboards").glob("*.jpg")):
        image = np.asarray(Image.open(path), dtype=np.float64)
        sides = board_sides(image)
        level = linear_from_srgb(image) if is_srgb else image
        source = EdgeImage(name=path.name, image_dn=level, saturation_dn=255.0, is_jpeg=True)
        edges = _told_apart(edges_of_image(source))
        on_board = [[edge for edge in edges if lies_on(edge, side)] for side in sides]
        count += len(sides)
        measured += sum(any(edge.is_used for edge in found) for found in on_board)
        beside += sum("beside_target" in edge.flags for found in on_board for edge in found)
        used = [edge for edge in edges if edge.is_used]
        assert all(is_among_the_pixels(edge, level) for edge in used), path.name
        # The softest genuine sides of the boards: 1.51 px.
        assert all(edge.sigma_px < 1.6 for edge in used), path.name
        # The room has its own edges: a screen, a keyboard, the rim of the board.
        assert sum("beside_target" in edge.flags for edge in edges) >= 20, path.name
    assert count == 740  # of 8 x 93
    assert measured >= 0.97 * count
    assert beside == 0
