"""Widths and MTF50 of edges in few levels, and behind JPEG: how often 95 % intervals hold.

The truth is a closed form (an edge behind square pixels, at any angle); the files are rounded to
8 bits, and compressed by OpenCV. Errors are in units of the standard error that each fit states:
an RMS of 1 and 95 % in the interval is right, and of 1,000 the RMS itself scatters by 0.022.

    python -m benchmarks.studies.edge_levels [--edges 1000] [--quick]
"""

from collections.abc import Iterator
from io import BytesIO
from typing import Annotated

import cv2
import numpy as np
from PIL import Image

from benchmarks.harness import Recorder, benchmark
from benchmarks.scoring import Errors
from benchmarks.truth.edges import Rectangle, exact_edge, gaussian_mtf50, patches, pixel_means
from calibration.edges import (
    EdgeImage,
    EdgeSelection,
    JpegCompression,
    find_edges,
    fit_edge,
)
from calibration.psf import psf_of_images
from simulation.arrays import FloatArray

Range = tuple[float, float]
LEAST_SIDE_PX, LARGEST_SIDE_PX = 90, 130
SIDE_PX = 100
BOARD_SHAPE, BOARD_FIELDS = (280, 340), (6, 8)
COLUMNS = "rms   most  in 95 %  rms %  worst %  missed"


def _line(errors: Errors) -> str:
    """RMS, largest, coverage, RMS and worst in %, and what was missed."""
    rms = 100 * float(np.sqrt(np.mean(np.square(errors.relative))))
    return (
        f"{errors.rms:6.3f} {errors.most:6.2f} {errors.coverage:7.1f} {rms:7.3f}"
        f" {errors.worst:7.2f} {errors.missed:7d}"
    )


def compressed(image: FloatArray, quality: int) -> tuple[FloatArray, JpegCompression]:
    """Levels from 0 to 255 as a JPEG gives them back, and how it was made."""
    codes = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    data = cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    with Image.open(BytesIO(data)) as opened:
        steps = np.array(opened.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]  # JPEG's own
        decoded = np.asarray(opened, dtype=np.float64)
    return decoded, JpegCompression(steps=steps, code_levels_dn=np.arange(256.0))


def _fitted(
    images: Iterator[tuple[FloatArray, float]], quality: int, sides: int | None = None
) -> Errors:
    """Fit the edges of images of known width, in 8 bits and behind JPEG where there is a quality.

    All ``sides`` of them, or the longest edge alone.
    """
    errors = Errors()
    for image, sigma in images:
        levels, compression, artefacts = np.rint(image), None, None
        if quality:
            levels, compression = compressed(image, quality)
            artefacts = compression.artefacts
        segments = find_edges(levels, cell_px=1000.0, artefacts=artefacts)
        if sides is None:
            segments = sorted(segments, key=lambda edge: -edge.length_px)[:1]
        errors.missed += max((sides or 1) - len(segments), 0)
        for segment in segments:
            fit = fit_edge(levels, segment, compression=compression)
            if fit is None:
                errors.missed += 1
            else:
                errors.add(fit.optical_sigma_px, fit.optical_sigma_err_px, sigma)
    return errors


def level_errors(
    edges: int, contrast_dn: Range, noise_dn: Range, sigma_px: Range, seed: int, quality: int = 0
) -> Errors:
    """Fit random edges in 8 bits, behind JPEG where there is a ``quality``."""

    def images(rng: np.random.Generator) -> Iterator[tuple[FloatArray, float]]:
        for _ in range(edges):
            sigma = float(np.exp(rng.uniform(*np.log(sigma_px))))
            contrast, noise = rng.uniform(*contrast_dn), rng.uniform(*noise_dn)
            side = int(rng.integers(LEAST_SIDE_PX, LARGEST_SIDE_PX))
            low = rng.uniform(15, 235 - contrast)
            y, x = np.mgrid[:side, :side] - (side - 1) / 2
            place = [rng.uniform(0, 2 * np.pi), rng.uniform(-3, 3)]
            truth = np.array([*place, 0, np.log(sigma), low, low + contrast])
            yield exact_edge(truth, x, y) + noise * rng.standard_normal(x.shape), sigma

    return _fitted(images(np.random.default_rng(seed)), quality)


def _side_errors(squares: int, side_px: int, noise_dn: Range, quality: int) -> Errors:
    """Fit the sides of dark squares, at any angle, place, contrast and width of the lens."""

    def images(rng: np.random.Generator) -> Iterator[tuple[FloatArray, float]]:
        size = int(np.ceil(1.5 * side_px)) + 32
        y, x = (axis.astype(np.float64) for axis in np.mgrid[:size, :size])
        for _ in range(squares):
            sigma = float(np.exp(rng.uniform(*np.log((0.7, 1.5)))))
            contrast, noise = rng.uniform(40, 200), rng.uniform(*noise_dn)
            white = rng.uniform(15, 235 - contrast) + contrast
            middle = size / 2 + rng.uniform(-0.5, 0.5, 2)
            square = Rectangle(
                x_px=middle[0],
                y_px=middle[1],
                half_px=(side_px / 2, side_px / 2),
                angle_rad=rng.uniform(0, np.pi / 2),
                level_dn=white - contrast,
            )
            cover = pixel_means(lambda x, y: square.share(sigma, x, y), x, y)  # noqa: B023
            yield white - contrast * cover + noise * rng.standard_normal(cover.shape), sigma

    return _fitted(images(np.random.default_rng(3)), quality, sides=4)


def mtf50_errors(edges: int, sigma_px: float, quality: int, seed: int) -> Errors:
    """Measure MTF50 of edges of 100 px, in 8 bits, behind JPEG where there is a ``quality``."""
    rng, errors = np.random.default_rng(seed), Errors()
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] - (SIDE_PX - 1) / 2
    for _ in range(edges):
        normal = rng.uniform(0, 2 * np.pi)
        contrast, noise = rng.uniform(40, 200), rng.uniform(0.5, 2)
        low = rng.uniform(15, 235 - contrast)
        place = [normal, rng.uniform(-1, 1)]
        truth = np.array([*place, 0, np.log(sigma_px), low, low + contrast])
        levels = exact_edge(truth, x, y) + noise * rng.standard_normal(x.shape)
        compression = None
        if quality:
            levels, compression = compressed(levels, quality)
        source = EdgeImage(
            name="edge",
            image_dn=np.clip(np.rint(levels), 0, 255),
            saturation_dn=255.0,
            is_jpeg=compression is not None,
            compression=compression,
        )
        measured = EdgeSelection().measured_in(source, "all-angles")
        if measured:
            edge = max(measured, key=lambda edge: edge.length_px)
            value, err = edge.esfr_mtf50_cy_per_px, edge.esfr_mtf50_err_cy_per_px
            errors.add(value, err, gaussian_mtf50(sigma_px, normal))
        else:
            errors.missed += 1
    return errors


def _mtf50s(record: Recorder, edges: int) -> None:
    record.say(f"\nMTF50, contrast 40 to 200, noise 0.5 to 2, {edges} edges of 100 px a line")
    record.say(f"  quality  sigma    {COLUMNS}")
    for quality in (0, 95, 90, 85, 75):
        for sigma in (0.7, 1.0, 1.5, 2.0):
            errors = mtf50_errors(edges, sigma, quality, seed=4)
            stored = f"JPEG {quality}" if quality else "8 bits"
            name = f"MTF50, sigma {sigma}, {stored}"
            record.figure(f"RMS of error over stated, {name}", errors.rms, "stated errors")
            record.figure(f"in the 95 % interval, {name}", errors.coverage, "%")
            record.say(f"  {quality:7d} {sigma:6.1f} {_line(errors)}")


def _eight_bits(record: Recorder, edges: int) -> None:
    record.say(f"\n8 bits, {edges} edges a line; contrast and noise in DN, sigma in px")
    record.say(f"  contrast     noise      sigma    {COLUMNS}")
    for contrast, noise, sigma in (
        ((20.0, 60.0), (0.2, 0.4), (0.7, 1.5)),
        ((20.0, 60.0), (0.5, 1.0), (0.7, 1.5)),
        ((20.0, 60.0), (0.0, 0.0), (0.7, 1.5)),
        ((10.0, 200.0), (0.1, 3.0), (0.4, 3.0)),
    ):
        errors = level_errors(edges, contrast, noise, sigma, seed=1)
        name = f"contrast {contrast}, noise {noise}, sigma {sigma}"
        record.figure(f"RMS of error over stated, {name}", errors.rms, "stated errors")
        record.figure(f"in the 95 % interval, {name}", errors.coverage, "%")
        record.say(f"  {contrast!s:13}{noise!s:11}{sigma!s:10}{_line(errors)}")


def _jpegs(record: Recorder, edges: int) -> None:
    record.say(f"\nJPEG, contrast 40 to 200, noise 0.5 to 2, sigma 0.7 to 1.5 px, {edges} a line")
    record.say(f"  quality    {COLUMNS}")
    for quality in (75, 80, 85, 90, 95):
        errors = level_errors(edges, (40.0, 200.0), (0.5, 2.0), (0.7, 1.5), seed=2, quality=quality)
        record.figure(f"in the 95 % interval, JPEG {quality}", errors.coverage, "%")
        record.figure(f"worst error, JPEG {quality}", errors.worst, "%")
        record.say(f"  {quality:7d} {_line(errors)}")


def _squares(record: Recorder, sides: int) -> None:
    record.say(f"\nsides of squares, contrast 40 to 200, sigma 0.7 to 1.5 px, {sides} a line")
    record.say(f"  side   noise       quality    {COLUMNS}")
    for side_px in (60, 100):
        for noise, quality in (((0.5, 1.0), 0), ((0.5, 1.0), 95), ((0.0, 0.4), 95)):
            errors = _side_errors(sides // 4, side_px, noise, quality)
            stored = f"JPEG {quality}" if quality else "8 bits"
            name = f"squares of {side_px} px, noise {noise}, {stored}"
            record.figure(f"RMS of error over stated, {name}", errors.rms, "stated errors")
            record.figure(f"worst error, {name}", errors.worst, "%")
            record.say(f"  {side_px:4d}   {noise!s:11} {quality:5d} {_line(errors)}")


def _board_scene(rng: np.random.Generator, sigma_px: float) -> FloatArray:
    """A chessboard with fields of 24 to 38 px, a few degrees from upright, with noise."""
    pitch, turn = rng.uniform(24, 38), np.deg2rad(rng.uniform(-8, 8))
    dark, white = rng.uniform(30, 60), rng.uniform(150, 220)
    c, s = np.cos(turn), np.sin(turn)
    middle = BOARD_SHAPE[1] / 2 + rng.uniform(0, 8), BOARD_SHAPE[0] / 2 + rng.uniform(0, 8)
    rows, cols = BOARD_FIELDS
    squares = []
    for row in range(rows):
        for col in range(row % 2, cols, 2):
            u, v = pitch * (col + 0.5 - cols / 2), pitch * (row + 0.5 - rows / 2)
            squares.append(
                Rectangle(
                    x_px=middle[0] + c * u - s * v,
                    y_px=middle[1] + s * u + c * v,
                    half_px=(pitch / 2, pitch / 2),
                    angle_rad=turn,
                    level_dn=dark,
                )
            )
    image = patches(BOARD_SHAPE, squares, white, sigma_px)
    return image + rng.uniform(0.5, 1.5) * rng.standard_normal(image.shape)


def _boards(record: Recorder, count: int) -> None:
    """Widths of the lens from all edges of a board together."""
    record.say(
        f"\nboards of fields of 24 to 38 px, {count} a line: sigma_x and sigma_y of the lens"
    )
    record.say(f"  quality  sigma    {COLUMNS}")
    for quality in (50, 75, 90):
        for sigma in (0.6, 0.9, 1.4):
            rng, errors = np.random.default_rng(quality), Errors()
            for _ in range(count):
                levels, compression = compressed(_board_scene(rng, sigma), quality)
                source = EdgeImage(
                    name="board",
                    image_dn=levels,
                    saturation_dn=255.0,
                    is_jpeg=True,
                    compression=compression,
                )
                psf = psf_of_images([source])
                errors.add(psf.optical_sigma_x_px, psf.optical_sigma_x_err_px, sigma)
                errors.add(psf.optical_sigma_y_px, psf.optical_sigma_y_err_px, sigma)
            name = f"boards, sigma {sigma}, JPEG {quality}"
            record.figure(f"in the 95 % interval, {name}", errors.coverage, "%")
            record.figure(f"worst error, {name}", errors.worst, "%")
            record.say(f"  {quality:7d} {sigma:6.1f} {_line(errors)}")


@benchmark("numpy", "numba", "opencv-contrib-python-headless", "Pillow")
def main(
    record: Recorder, *, edges: Annotated[int | None, "edges a line, 1000 by default"] = None
) -> None:
    edges = edges or record.pick(1000, 50)
    _eight_bits(record, edges)
    _jpegs(record, edges)
    _mtf50s(record, record.pick(300, 24))
    _squares(record, record.pick(480, 24))
    _boards(record, record.pick(40, 2))
