"""Photographs of scenes with depth, taken by others: what is listed, and spots that are found.

Pairs of the folder ``planar_pairs`` of ``STANDOFF_REAL_DATA``, as the luma of their bytes: pixels
listed as a plane and with depth, and what is compared. Nobody knows what changed between them; so
spots of 2 px and 70 DN are painted on each follow-up, at random places that are compared and apart,
and counted where they are listed and nothing was before.

    STANDOFF_REAL_DATA=... python -m benchmarks.studies.depth_photographs [--quick]
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from scipy.ndimage import binary_erosion

from analysis.changes import ChangeOptions, ChangeResult, changes_between
from benchmarks.harness import Recorder, benchmark, outcomes, real_data
from benchmarks.studies.depth import is_listed
from simulation.arrays import Float32Array

PAIRS = ("adam", "BruggeSquare", "Eiffel", "CapitalRegion", "LePoint1", "boat", "WhiteBoard")
QUICK = ("adam",)
SPOT_DN, SPOT_SIGMA_PX, SPOTS = 70.0, 2.0, 10
APART_PX, INNER_PX = 40.0, 5


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """What was found in one pair, and of spots painted on it."""

    name: str
    has_depth: bool
    listed_px: int
    compared_px: int
    listed_flat_px: int
    compared_flat_px: int
    spots: int
    spots_compared: int
    spots_found: int


def _read(path: Path) -> Float32Array:
    found = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if found is None:
        raise OSError(f"{path} cannot be read")
    return found.astype(np.float32)


def _painted(
    after: Float32Array, found: ChangeResult
) -> tuple[Float32Array, list[tuple[int, int]]]:
    """The follow-up with spots where it is compared and nothing is listed, and their places."""
    rng = np.random.default_rng(3)
    free = binary_erosion(found.valid & ~found.is_change, iterations=INNER_PX)
    image, places = after.copy(), []
    y, x = np.indices(after.shape)
    for _ in range(SPOTS):
        at = np.argwhere(free)
        if not len(at):
            break
        row, col = at[rng.integers(len(at))].tolist()
        free &= np.hypot(y - row, x - col) > APART_PX
        # Towards grey, so that it is not clipped.
        sign = 1.0 if after[row, col] < 128 else -1.0
        image += (
            sign
            * SPOT_DN
            * np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * SPOT_SIGMA_PX**2)).astype(np.float32)
        )
        places.append((row, col))
    return np.rint(image), places


def _row(folder: Path, name: str) -> _Row:
    suffix = "jpg" if (folder / f"{name}A.jpg").is_file() else "png"
    before, after = (_read(folder / f"{name}{one}.{suffix}") for one in "AB")
    flat = changes_between(before, after, options=ChangeOptions(flat=True))
    found = changes_between(before, after)
    image, places = _painted(after, found)
    changed = changes_between(before, image)
    compared = [bool(changed.valid[place]) for place in places]
    hits = [is_listed(changed, *place) and not is_listed(found, *place) for place in places]
    return _Row(
        name=name,
        has_depth=found.parallax is not None,
        listed_px=found.summary.changed_px,
        compared_px=found.summary.compared_px,
        listed_flat_px=flat.summary.changed_px,
        compared_flat_px=flat.summary.compared_px,
        spots=len(places),
        spots_compared=sum(compared),
        spots_found=sum(hits),
    )


@benchmark()
def main(record: Recorder, *, workers: Annotated[int, "processes"] = 2) -> None:
    """Measure all pairs that are there."""
    folder = real_data("planar_pairs")
    if folder is None:
        record.say("no photographs: set STANDOFF_REAL_DATA")
        return
    names = record.pick(PAIRS, QUICK)
    for name, row in outcomes(partial(_row, folder), names, workers):
        if not isinstance(row, _Row):
            raise TypeError(f"pair {name}") from row
        record.figure(f"{name}: listed", row.listed_px, "px", "plane", row.listed_flat_px)
        record.figure(f"{name}: compared", row.compared_px, "px", "plane", row.compared_flat_px)
        record.figure(f"{name}: spots found", row.spots_found, f"of {row.spots}")
        record.figure(f"{name}: spots compared", row.spots_compared, f"of {row.spots}")
