"""Widths of edges in few levels, and behind JPEG: how often the 95 % interval holds the truth.

The truth is a closed form (an edge behind square pixels, at any angle); the files are rounded to
8 bits, and compressed by OpenCV. Errors are in units of the standard error that each fit states:
an RMS of 1 and 95 % in the interval is right, and of 1,000 the RMS itself scatters by 0.022.

    python -m benchmarks.studies.edge_levels [--edges 1000] [--quick]
"""

from dataclasses import dataclass, field
from io import BytesIO
from typing import Annotated

import cv2
import numpy as np
from PIL import Image

from benchmarks.harness import Recorder, benchmark
from benchmarks.speed.edge_fit import exact_edge
from benchmarks.truth.edges import Rectangle, patches, pixel_means
from calibration.edges import EdgeFit, EdgeImage, EdgeSegment, JpegCompression, find_edges, fit_edge
from calibration.psf import psf_of_images
from simulation.arrays import FloatArray

Range = tuple[float, float]
LEAST_SIDE_PX, LARGEST_SIDE_PX = 90, 130
BOARD_SHAPE, BOARD_FIELDS = (280, 340), (6, 8)
HELD = 1.959964


@dataclass
class _Tally:
    """Errors over their stated ones and over the truth, and how many edges gave none."""

    scaled: list[float] = field(default_factory=list)
    relative: list[float] = field(default_factory=list)
    missed: int = 0

    def add(self, fit: EdgeFit | None, sigma_px: float) -> None:
        """Count a fit of an edge of known width, or that there is none."""
        if fit is None:
            self.missed += 1
        else:
            self.add_width(fit.optical_sigma_px, fit.optical_sigma_err_px, sigma_px)

    def add_width(self, found_px: float | None, err_px: float | None, sigma_px: float) -> None:
        """Count a width of a lens of known width, or that there is none."""
        if found_px is None or err_px is None:
            self.missed += 1
            return
        self.scaled.append((found_px - sigma_px) / err_px)
        self.relative.append(found_px / sigma_px - 1)

    def line(self) -> str:
        """Write RMS, largest, coverage, RMS and worst in %, and what was missed."""
        z, relative = np.array(self.scaled), 100 * np.array(self.relative)
        return (
            f"{self.rms:6.3f} {np.abs(z).max():6.2f} {self.coverage:7.1f}"
            f" {np.sqrt(np.mean(relative**2)):7.3f} {np.abs(relative).max():7.2f}"
            f" {self.missed:7d}"
        )

    @property
    def rms(self) -> float:
        """RMS of the errors over their stated ones."""
        return float(np.sqrt(np.mean(np.square(self.scaled))))

    @property
    def coverage(self) -> float:
        """Share of the 95 % intervals that hold the truth, in %."""
        return 100 * float(np.mean(np.abs(self.scaled) <= HELD))


def decoded(
    image: FloatArray, quality: int
) -> tuple[FloatArray, JpegCompression | None, list[EdgeSegment]]:
    """What a file of 8 bits gives back, a JPEG where there is a quality, and the edges in it."""
    if not quality:
        rounded = np.rint(image)
        return rounded, None, find_edges(rounded, cell_px=1000.0)
    levels, compression = compressed(image, quality)
    artefacts = compression.artefacts
    return levels, compression, find_edges(levels, cell_px=1000.0, artefacts=artefacts)


def compressed(image: FloatArray, quality: int) -> tuple[FloatArray, JpegCompression]:
    """Levels from 0 to 255 as a JPEG gives them back, and how it was made."""
    codes = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    data = cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    with Image.open(BytesIO(data)) as opened:
        steps = np.array(opened.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]  # JPEG's own
        decoded = np.asarray(opened, dtype=np.float64)
    return decoded, JpegCompression(steps=steps, code_levels_dn=np.arange(256.0))


def level_errors(
    edges: int, contrast_dn: Range, noise_dn: Range, sigma_px: Range, seed: int, quality: int = 0
) -> _Tally:
    """Fit random edges in 8 bits, behind JPEG where there is a ``quality``."""
    rng = np.random.default_rng(seed)
    tally = _Tally()
    for _ in range(edges):
        sigma = float(np.exp(rng.uniform(*np.log(sigma_px))))
        contrast, noise = rng.uniform(*contrast_dn), rng.uniform(*noise_dn)
        side = int(rng.integers(LEAST_SIDE_PX, LARGEST_SIDE_PX))
        low = rng.uniform(15, 235 - contrast)
        y, x = np.mgrid[:side, :side] - (side - 1) / 2
        truth = np.array(
            [rng.uniform(0, 2 * np.pi), rng.uniform(-3, 3), 0, np.log(sigma), low, low + contrast]
        )
        image = exact_edge(truth, x, y) + noise * rng.standard_normal(x.shape)
        image, compression, segments = decoded(image, quality)
        longest = max(segments, key=lambda e: e.length_px, default=None)
        fit = None if longest is None else fit_edge(image, longest, compression=compression)
        tally.add(fit, sigma)
    return tally


def _side_errors(
    squares: int, side_px: int, noise_dn: Range, seed: int, quality: int = 0
) -> _Tally:
    """Fit the sides of dark squares, at any angle, place, contrast and width of the lens."""
    rng = np.random.default_rng(seed)
    tally = _Tally()
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
        light = white - contrast * pixel_means(lambda x, y: square.share(sigma, x, y), x, y)  # noqa: B023
        image = light + noise * rng.standard_normal(light.shape)
        image, compression, segments = decoded(image, quality)
        for segment in segments:
            tally.add(fit_edge(image, segment, compression=compression), sigma)
        tally.missed += max(4 - len(segments), 0)
    return tally


def _eight_bits(record: Recorder, edges: int) -> None:
    record.say(f"\n8 bits, {edges} edges a line; contrast and noise in DN, sigma in px")
    record.say("  contrast     noise      sigma    rms   most  in 95 %  rms %  worst %  missed")
    for contrast, noise, sigma in (
        ((20.0, 60.0), (0.2, 0.4), (0.7, 1.5)),
        ((20.0, 60.0), (0.5, 1.0), (0.7, 1.5)),
        ((20.0, 60.0), (0.0, 0.0), (0.7, 1.5)),
        ((10.0, 200.0), (0.1, 3.0), (0.4, 3.0)),
    ):
        tally = level_errors(edges, contrast, noise, sigma, seed=1)
        name = f"contrast {contrast}, noise {noise}, sigma {sigma}"
        record.figure(f"RMS of error over stated, {name}", tally.rms, "stated errors")
        record.figure(f"in the 95 % interval, {name}", tally.coverage, "%")
        record.say(f"  {contrast!s:13}{noise!s:11}{sigma!s:10}{tally.line()}")


def _jpegs(record: Recorder, edges: int) -> None:
    record.say(f"\nJPEG, contrast 40 to 200, noise 0.5 to 2, sigma 0.7 to 1.5 px, {edges} a line")
    record.say("  quality    rms   most  in 95 %  rms %  worst %  missed")
    for quality in (75, 80, 85, 90, 95):
        tally = level_errors(edges, (40.0, 200.0), (0.5, 2.0), (0.7, 1.5), seed=2, quality=quality)
        record.figure(f"in the 95 % interval, JPEG {quality}", tally.coverage, "%")
        record.figure(f"worst error, JPEG {quality}", 100 * max(map(abs, tally.relative)), "%")
        record.say(f"  {quality:7d} {tally.line()}")


def squares(record: Recorder, sides: int) -> None:
    record.say(f"\nsides of squares, contrast 40 to 200, sigma 0.7 to 1.5 px, {sides} a line")
    record.say("  side   noise       quality    rms   most  in 95 %  rms %  worst %  missed")
    for side_px in (60, 100):
        for noise, quality in (((0.5, 1.0), 0), ((0.5, 1.0), 95), ((0.0, 0.4), 95)):
            tally = _side_errors(sides // 4, side_px, noise, seed=3, quality=quality)
            name = f"squares of {side_px} px, noise {noise}, " + (
                f"JPEG {quality}" if quality else "8 bits"
            )
            record.figure(f"RMS of error over stated, {name}", tally.rms, "stated errors")
            record.figure(f"worst error, {name}", 100 * max(map(abs, tally.relative)), "%")
            record.say(f"  {side_px:4d}   {noise!s:11} {quality:5d} {tally.line()}")


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
    record.say("  quality  sigma    rms   most  in 95 %  rms %  worst %  missed")
    for quality in (50, 75, 90):
        for sigma in (0.6, 0.9, 1.4):
            rng, tally = np.random.default_rng(quality), _Tally()
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
                tally.add_width(psf.optical_sigma_x_px, psf.optical_sigma_x_err_px, sigma)
                tally.add_width(psf.optical_sigma_y_px, psf.optical_sigma_y_err_px, sigma)
            name = f"boards, sigma {sigma}, JPEG {quality}"
            record.figure(f"in the 95 % interval, {name}", tally.coverage, "%")
            record.figure(f"worst error, {name}", 100 * max(map(abs, tally.relative)), "%")
            record.say(f"  {quality:7d} {sigma:6.1f} {tally.line()}")


@benchmark("numpy", "numba", "opencv-contrib-python-headless", "Pillow")
def main(
    record: Recorder, *, edges: Annotated[int | None, "edges a line, 1000 by default"] = None
) -> None:
    edges = edges or record.pick(1000, 50)
    _eight_bits(record, edges)
    _jpegs(record, edges)
    squares(record, record.pick(480, 24))
    _boards(record, record.pick(40, 2))
