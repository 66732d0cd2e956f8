"""Widths of edges in few levels, and behind JPEG: how often the 95 % interval holds the truth.

The truth is a closed form (an edge behind square pixels, at any angle); the files are rounded to
8 bits, and compressed by OpenCV. Errors are in units of the standard error that each fit states:
an RMS of 1 and 95 % in the interval is right, and of 1,000 the RMS itself scatters by 0.022.

    python -m benchmarks.bench_edge_levels [--edges 1000] [--quick]
"""

from dataclasses import dataclass, field
from io import BytesIO

import cv2
import numpy as np
from PIL import Image

from benchmarks.bench_edge_fit import exact_edge
from benchmarks.harness import Recorder, bench_parser
from calibration.edge_fit import JpegCompression, fit_edge
from calibration.edge_search import EdgeSegment, find_edges
from simulation.arrays import FloatArray

Range = tuple[float, float]
LEAST_SIDE_PX, LARGEST_SIDE_PX = 90, 130
HELD = 1.959964


@dataclass
class Tally:
    """Errors over their stated ones and over the truth, and how many edges gave none."""

    scaled: list[float] = field(default_factory=list)
    relative: list[float] = field(default_factory=list)
    missed: int = 0

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
) -> Tally:
    """Fit random edges in 8 bits, behind JPEG where there is a ``quality``."""
    rng = np.random.default_rng(seed)
    tally = Tally()
    for _ in range(edges):
        sigma = float(np.exp(rng.uniform(*np.log(sigma_px))))
        contrast, noise = rng.uniform(*contrast_dn), rng.uniform(*noise_dn)
        side = int(rng.integers(LEAST_SIDE_PX, LARGEST_SIDE_PX))
        low = rng.uniform(15, 235 - contrast)
        y, x = np.mgrid[:side, :side] - (side - 1) / 2
        truth = np.array(
            [rng.uniform(0, 2 * np.pi), rng.uniform(-3, 3), 0, np.log(sigma), low, low + contrast]
        )
        image = np.rint(exact_edge(truth, x, y) + noise * rng.standard_normal(x.shape))
        compression = None
        if quality:
            image, compression = compressed(image, quality)
        artefacts = None if compression is None else compression.artefacts
        segments = find_edges(image, cell_px=1000.0, artefacts=artefacts)
        fit = None
        if segments:
            longest: EdgeSegment = max(segments, key=lambda e: e.length_px)
            fit = fit_edge(image, longest, compression=compression)
        if fit is None or fit.optical_sigma_px is None or fit.optical_sigma_err_px is None:
            tally.missed += 1
            continue
        tally.scaled.append((fit.optical_sigma_px - sigma) / fit.optical_sigma_err_px)
        tally.relative.append(fit.optical_sigma_px / sigma - 1)
    return tally


def eight_bits(record: Recorder, edges: int) -> None:
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


def jpegs(record: Recorder, edges: int) -> None:
    record.say(f"\nJPEG, contrast 40 to 200, noise 0.5 to 2, sigma 0.7 to 1.5 px, {edges} a line")
    record.say("  quality    rms   most  in 95 %  rms %  worst %  missed")
    for quality in (75, 80, 85, 90, 95):
        tally = level_errors(edges, (40.0, 200.0), (0.5, 2.0), (0.7, 1.5), seed=2, quality=quality)
        record.figure(f"in the 95 % interval, JPEG {quality}", tally.coverage, "%")
        record.figure(f"worst error, JPEG {quality}", 100 * max(map(abs, tally.relative)), "%")
        record.say(f"  {quality:7d} {tally.line()}")


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--edges", type=int, help="edges a line, 1000 by default")
    given = parser.parse_args()
    packages = ("numpy", "numba", "opencv-contrib-python-headless", "pillow")
    with Recorder.of(given, "edge_levels", packages=packages) as record:
        edges = given.edges or record.pick(1000, 50)
        eight_bits(record, edges)
        jpegs(record, edges)


if __name__ == "__main__":
    main()
