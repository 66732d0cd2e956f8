"""Reading photographs: time beside the bare decoder, and the width of an edge by encoding.

Run with ``python -m benchmarks.speed.photographs [--quick]``. The reader hashes and checks the
file, finds the encoding and decodes to linear light; the peer decodes the stored levels, no more.
"""

from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tifffile
from PIL import Image
from scipy.special import erf

from acquisition.photographs import LINEAR, ReadOptions, read_photograph
from benchmarks.harness import Recorder, benchmark, medians_s
from benchmarks.truth.pictures import srgb_of
from calibration.edges import EdgeImage, edges_of_image
from simulation.arrays import FloatArray

SIGMA_PX, ANGLE_DEG = 0.8, 5.0
NOISE = 0.01  # of white, about a code on the bright side
LOW_NOISE = 0.001  # a tenth of a code: each side is rounded to one


def _light(shape: tuple[int, int]) -> FloatArray:
    """An edge of known width from 0.05 to 0.85 of white, in light."""
    y, x = np.mgrid[: shape[0], : shape[1]] - np.reshape(shape, (2, 1, 1)) / 2
    turn = np.deg2rad(ANGLE_DEG)
    across = x * np.cos(turn) + y * np.sin(turn)
    return np.asarray(0.45 + 0.4 * erf(across / (SIGMA_PX * np.sqrt(2))))


def _with_pillow(path: Path) -> object:
    with Image.open(path) as image:
        return np.asarray(image)


def _to_light(path: Path) -> object:
    return read_photograph(path).linear_planes


def _width_px(path: Path, options: ReadOptions) -> float:
    found = read_photograph(path, options)
    edges = edges_of_image(EdgeImage(name=path.name, image_dn=found.grey_dn, is_jpeg=found.is_jpeg))
    return float(np.mean([edge.sigma_px for edge in edges]))


@benchmark("Pillow", "tifffile", "imagecodecs")
def main(record: Recorder) -> None:
    shape, rounds = record.pick(((3000, 4000), 7), ((1500, 2000), 3))
    with TemporaryDirectory() as folder:
        noise = np.random.default_rng(0).normal(0.0, NOISE, shape)
        linear = np.clip(_light(shape) + noise, 0.0, 1.0)
        bytes_srgb = np.rint(srgb_of(linear) * 255).astype(np.uint8)
        colour = np.dstack([bytes_srgb] * 3)
        jpeg, png, tiff = (Path(folder) / f"edge.{kind}" for kind in ("jpg", "png", "tif"))
        buffer = BytesIO()
        Image.fromarray(colour).save(buffer, "JPEG", quality=95)
        jpeg.write_bytes(buffer.getvalue())
        Image.fromarray(bytes_srgb).save(png)
        tifffile.imwrite(
            tiff, np.rint(linear * 65535).astype(np.uint16), compression="lzw", predictor=True
        )
        peers: tuple[tuple[str, Path, Callable[[], object], str], ...] = (
            ("JPEG in colour", jpeg, partial(_with_pillow, jpeg), "Pillow alone"),
            ("8-bit PNG", png, partial(_with_pillow, png), "Pillow alone"),
            ("16-bit TIFF, LZW", tiff, partial(tifffile.imread, tiff), "tifffile alone"),
        )
        megapixels = shape[0] * shape[1] / 1e6
        for name, path, peer, peer_name in peers:
            ours_s, peer_s = medians_s([partial(_to_light, path), peer], rounds)
            what = f"{name} of {megapixels:g} Mpx to linear light"
            record.time(what, ours_s, peer_name, peer_s)
        quiet = Path(folder) / "quiet.png"
        fine = np.clip(_light(shape) + noise * (LOW_NOISE / NOISE), 0.0, 1.0)
        Image.fromarray(np.rint(srgb_of(fine) * 255).astype(np.uint8)).save(quiet)
        for name, path in (
            ("JPEG, quality 95", jpeg),
            ("8-bit PNG", png),
            ("8-bit PNG with little noise", quiet),
        ):
            error = 100 * abs(_width_px(path, ReadOptions()) / SIGMA_PX - 1)
            as_linear = 100 * abs(_width_px(path, ReadOptions(encoding=LINEAR)) / SIGMA_PX - 1)
            record.figure(f"error of sigma, {name}", error, "%", "taken as linear", as_linear)
