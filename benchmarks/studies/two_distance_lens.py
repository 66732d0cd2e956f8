"""The lens from photographs at two distances, beside the kernel between them without any model.

Both measure the pairs without an edge of the public benchmark's track ``psf``. Printed are errors
of the MTF50 along x and y, and how many of the 95 % intervals hold the truth. Pairs of no or little
noise are measured once more as a phone stores them: tinted, as JPEG 95 of half as many chroma
samples. Then a smooth scene, blobs behind a Gaussian, whose near photograph has noise and whose far
one has none.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.two_distance_lens [--seeds N,N,...]
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from PIL import Image

import standoff
from benchmarks.harness import Recorder, benchmark
from benchmarks.peers import blind, ours
from benchmarks.peers.program import EdgeContrast, PeerError, Task
from benchmarks.studies.one_photograph import pairs_without_edge
from calibration.blind import NearAndFar, pair_psf
from calibration.blind.two_distance import ClippedPixels
from tests.calibration.blob_scene import blob_photograph, far_to_near

SEEDS = (7105, 7106, 7107, 7108)
_QUICK = 4
_ZOOM, _SHAPE = 2.0, (240, 320)
_NOISES_DN = (0.0, 5.0, 20.0)
_WIDTHS_PX2 = (0.45, 0.33)
_TINT, _CHROMA, _QUALITY = (1.0, 0.85, 0.6), "4:2:0", 95
_COLOUR = "colour JPEG"
_IN_COLOUR = ("clean", "little noise")
_PROGRAMS = {"standoff": ours.contrasts, "delbracio": blind.delbracio}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """Relative errors of the MTF50 along both axes, and those stated, NaN where none is."""

    program: str
    condition: str
    errors: tuple[float, ...]
    stated: tuple[float, ...]


def _pairs(seed: int, count: int | None) -> Iterator[_Found]:
    """What both find on the pairs of a seed."""
    for task, truth in pairs_without_edge(seed, count):
        for program, find in _PROGRAMS.items():
            try:
                yield _judged(program, truth["condition"], find(task), truth)
            except PeerError:
                continue
        if truth["condition"] in _IN_COLOUR:
            yield _judged("standoff", _COLOUR, _in_colour(task), truth)


def _judged(
    program: str, condition: str, answers: list[EdgeContrast], truth: dict[str, Any]
) -> _Found:
    true = [truth["edges"][answer.edge]["mtf50"] for answer in answers]
    both = [
        (answer.mtf50 / one - 1, (answer.mtf50_standard_error or np.nan) / one)
        for answer, one in zip(answers, true, strict=True)
        if answer.mtf50 is not None
    ]
    return _Found(
        program=program,
        condition=condition,
        errors=tuple(error for error, _ in both),
        stated=tuple(stated for _, stated in both),
    )


def _in_colour(task: Task) -> list[EdgeContrast]:
    """What a pair says as tinted JPEGs, at any exposure."""
    both = [task.linear(key) for key in ("nearer_file", "file")]
    white = max(float(np.quantile(image, 0.999)) for image in both) / 0.95
    with TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("near.jpg", "far.jpg")]
        for path, image in zip(paths, both, strict=True):
            light = np.clip(image[..., None] / white * np.array(_TINT), 0.0, 1.0)
            dark, bright = 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055  # IEC 61966-2-1
            codes = np.rint(255 * np.where(light <= 0.0031308, dark, bright)).astype(np.uint8)
            Image.fromarray(codes).save(path, quality=_QUALITY, subsampling=_CHROMA)
        return ours.along_axes(standoff.calibrate_psf(paths, method="two-distance"))


def _say_pairs(record: Recorder, found: list[_Found]) -> None:
    for program in _PROGRAMS:
        for condition in ("", *sorted({one.condition for one in found})):
            own = [one for one in found if one.program == program]
            own = [one for one in own if one.condition == (condition or one.condition)]
            if not condition:  # beside each other: of the same files
                own = [one for one in own if one.condition != _COLOUR]
            if not own:
                continue
            errors = np.array([error for one in own for error in one.errors])
            stated = np.array([error for one in own for error in one.stated])
            median, most = (100 * float(of(np.abs(errors))) for of in (np.median, np.max))
            words = f"{len(own):3d} pairs, median {median:.2f} %, {most:.1f} % at most"
            if np.isfinite(stated).all():
                held = 100 * float(np.mean(np.abs(errors) <= 1.96 * stated))
                words += f", {held:.0f} % of intervals hold"
            record.say(f"  {program:10} {condition or 'all':14} {words}")
            if not condition:
                record.figure(f"two distances: median error of MTF50, {program}", median, "%")


def _say_blobs(record: Recorder, noise_dn: float) -> None:
    """A smooth scene, of which only the near photograph has noise."""
    near, far = (blob_photograph(zoom, np.diag(_WIDTHS_PX2), shape=_SHAPE) for zoom in (1.0, _ZOOM))
    noisy = near + np.random.default_rng(5).normal(0, noise_dn, near.shape)
    pair = NearAndFar(
        near_dn=noisy,
        far_dn=far,
        clipped=ClippedPixels.none(_SHAPE, _SHAPE),
        near_noise_dn2=noise_dn**2,
    )
    gaussian = pair_psf(pair, far_to_near(_ZOOM)).gaussian
    sigma = np.sqrt(gaussian.px2[[0, 2]])
    err = np.sqrt(np.diag(gaussian.covariance))[[0, 2]] / sigma / 2
    off = sigma / np.sqrt(_WIDTHS_PX2) - 1
    record.figure(f"blobs, noise of {noise_dn:g} DN: width off at most", 100 * abs(off).max(), "%")
    record.say(
        "  stated " + ", ".join(f"{100 * e / s:.1f} %" for e, s in zip(err, sigma, strict=True))
    )


@benchmark("numpy", "scipy", "Pillow")
def main(
    record: Recorder,
    *,
    seeds: Annotated[str, "of the benchmark, with commas"] = ",".join(map(str, SEEDS)),
) -> None:
    numbers = record.pick([int(seed) for seed in seeds.split(",")], [1])
    _say_pairs(
        record,
        [one for seed in numbers for one in _pairs(seed, record.pick(None, _QUICK))],
    )
    for noise_dn in _NOISES_DN:
        _say_blobs(record, noise_dn)
