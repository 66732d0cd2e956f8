"""Programs that list what happened between two picture files; each entry has one place.

The plain difference, SSIM with contours and an alignment by features are what is written about this
question everywhere; ``standoff.find_changes`` is the product. Places are in follow-up pixels.
"""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from skimage.metrics import structural_similarity

import standoff
from benchmarks.peers.alignments import Matching, detector_of, magsac, matches_of
from benchmarks.peers.program import Entry, ListedThings, PeerError, Program, Task
from simulation.arrays import BoolArray
from standoff.errors import REPORTED_ERRORS

LEVELS = 20.0
SMOOTHING_PX = 1.5
CONTOUR_PX = 40
_OVERLAP_PX = 6

Levels = NDArray[np.float32]
"""Of 0 to 255; shape ``(rows, cols, 3)``."""


Lister = Callable[[Path, Path], tuple[Entry, ...]]
"""Lists what changed; PeerError where it cannot compare."""


def standoff_changes(before: Path, after: Path) -> tuple[Entry, ...]:
    """Entries of this project's comparison, changes and movements."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            summary = standoff.find_changes(before, after).summary
        except REPORTED_ERRORS as error:
            raise PeerError(" ".join(str(error).split())) from error
    return tuple(
        Entry(
            x_px=change.x_px,
            y_px=change.y_px,
            is_moved=is_moved,
            shift_px=change.displacement_px if is_moved else None,
            what=getattr(change, "what", None),
            parts=max(len(getattr(change, "parts", ())), 1),
        )
        for is_moved, changes in ((False, summary.changes), (True, summary.moved))
        for change in changes
    )


def plain_difference(before: Path, after: Path) -> tuple[Entry, ...]:
    """Connected pixels that differ by more than 20 levels in a channel, both smoothed by 1.5 px."""
    first, second = _both(before, after)
    return _listed(_differs(first, second))


def aligned_difference(before: Path, after: Path) -> tuple[Entry, ...]:
    """The plain difference behind a homography from SIFT's features."""
    first, second = _read(before), _read(after)
    greys = [cv2.cvtColor(image.astype(np.uint8), cv2.COLOR_BGR2GRAY) for image in (first, second)]
    matching = Matching(tolerance_px=3.0)
    matches = matches_of(np.asarray(greys[0]), np.asarray(greys[1]), detector_of("sift"), matching)
    matrix = magsac(matches, matching)
    size = second.shape[1], second.shape[0]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(first, matrix, size, flags=flags)
    shown = cv2.warpPerspective(np.ones(first.shape[:2], np.float32), matrix, size, flags=flags)
    inside = binary_erosion(shown > 0.99, iterations=_OVERLAP_PX)
    if not inside.any():
        raise PeerError("the alignment leaves nothing in common")
    return _listed(_differs(np.asarray(warped, dtype=np.float32), second) & inside)


def ssim_contours_otsu(before: Path, after: Path) -> tuple[Entry, ...]:
    """Contours of more than 40 px of SSIM's map behind Otsu's threshold, as blogs have it."""
    return _contours(before, after, is_otsu=True)


def _ssim_contours_half(before: Path, after: Path) -> tuple[Entry, ...]:
    """The same with one threshold, an SSIM of .5."""
    return _contours(before, after, is_otsu=False)


OURS = "standoff changes"
LISTERS: dict[str, Lister] = {
    OURS: standoff_changes,
    "plain difference": plain_difference,
    "SSIM, Otsu, contours": ssim_contours_otsu,
    "SSIM < .5, contours": _ssim_contours_half,
    "SIFT, difference": aligned_difference,
}


def _contours(before: Path, after: Path, *, is_otsu: bool) -> tuple[Entry, ...]:
    greys = [
        cv2.cvtColor(np.rint(image).astype(np.uint8), cv2.COLOR_BGR2GRAY)
        for image in _both(before, after)
    ]
    compare: Any = structural_similarity  # it states no types
    _, similarity = compare(*greys, full=True)
    shown = np.clip(255 * similarity, 0, 255).astype(np.uint8)
    kind = cv2.THRESH_BINARY_INV | (cv2.THRESH_OTSU if is_otsu else 0)
    _, mask = cv2.threshold(shown, 127, 255, kind)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    entries = list[Entry]()
    for contour in contours:
        if cv2.contourArea(contour) > CONTOUR_PX:
            x, y, wide, high = cv2.boundingRect(contour)
            entries.append(Entry(x_px=x + (wide - 1) / 2, y_px=y + (high - 1) / 2))
    return tuple(entries)


def _differs(first: Levels, second: Levels) -> BoolArray:
    smooth = [cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX) for image in (first, second)]
    return np.asarray(np.abs(smooth[1] - smooth[0]).max(axis=2) > LEVELS)


def _listed(mask: BoolArray) -> tuple[Entry, ...]:
    _, _, _, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return tuple(Entry(x_px=float(x), y_px=float(y)) for x, y in centres[1:])


def _both(before: Path, after: Path) -> tuple[Levels, Levels]:
    first, second = _read(before), _read(after)
    if first.shape != second.shape:
        raise PeerError("frames of two sizes")
    return first, second


def _read(path: Path) -> Levels:
    """Stored levels; 16 bits are scaled to 255."""
    stored = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    if stored is None:
        raise PeerError(f"OpenCV does not read {path.name}")
    scale = 255 / 65535 if stored.dtype == np.uint16 else 1.0
    return np.asarray(stored, dtype=np.float32) * np.float32(scale)


def _program(name: str, given: str, lister: Lister, *packages: str) -> Program:
    return Program(
        name=name,
        given=f"{given}; the two files alone",
        answers={"things": lambda task: listed(task, lister)},
        packages=packages,
    )


def listed(task: Task, lister: Lister) -> ListedThings:
    """What a program lists of a pair."""
    return ListedThings(entries=lister(task.path("reference"), task.path("followup")))


PROGRAMS = (
    _program(
        "plain-difference",
        "connected pixels that differ by more than 20 levels in a channel, both photographs "
        "smoothed by 1.5 px",
        plain_difference,
        "opencv-contrib-python-headless",
    ),
    _program(
        "sift-difference",
        "the same behind a homography by OpenCV's SIFT and USAC_MAGSAC",
        aligned_difference,
        "opencv-contrib-python-headless",
    ),
    _program(
        "ssim-contours",
        "contours of more than 40 px of scikit-image's SSIM behind Otsu's threshold",
        ssim_contours_otsu,
        "scikit-image",
    ),
    _program(
        "ssim-half-contours",
        "contours of more than 40 px where scikit-image's SSIM is below .5",
        _ssim_contours_half,
        "scikit-image",
    ),
)
