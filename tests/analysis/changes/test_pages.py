"""A page of print beside a scan of it: paper is white and print black, and neither is cut off."""

from functools import cache

import cv2
import numpy as np
import pytest

from analysis.changes import ChangeResult, changes_between
from analysis.changes._ends import is_of_two_levels
from simulation.arrays import AnyArray, Float32Array

ERASED_PX, SPECK_PX = (112.0, 224.0), (430.0, 320.0)
ZOOM, TURN_DEG = 1.2, 1.3


@cache
def page() -> Float32Array:
    """Return lines of print on white paper, drawn."""
    drawn = np.full((420, 520), 255, dtype=np.uint8)
    for line in range(12):
        text = f"No. {137 * line + 41} of lot {91 * line % 57}"
        at = (30, 40 + 32 * line)
        cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.8, 10, 2, cv2.LINE_AA)
    return drawn.astype(np.float32)


@cache
def to_page() -> Float32Array:
    """Return the matrix that takes the scan's pixels to the page's."""
    turn = np.asarray(cv2.getRotationMatrix2D((260.0, 210.0), TURN_DEG, ZOOM))
    turn[:, 2] += np.array([60.0, 55.0])
    turn = np.vstack([turn, [0, 0, 1]])
    return np.linalg.inv(turn).astype(np.float32)


@cache
def scan() -> Float32Array:
    """Return the page as a scanner sees it, with a word less and a speck more."""
    seen = page().copy()
    seen[208:238, 86:140] = 255.0
    cv2.circle(seen, (int(SPECK_PX[0]), int(SPECK_PX[1])), 4, 90.0, -1, cv2.LINE_AA)
    soft = cv2.GaussianBlur(20.0 + 0.85 * seen, (0, 0), 1.0)
    size = (700, 620)
    scanned = cv2.warpPerspective(
        soft, to_page(), size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderValue=228.0
    )
    noise = np.random.default_rng(1).normal(0.0, 2.0, scanned.shape)
    return np.asarray(np.rint(np.clip(scanned + noise, 0, 255)), dtype=np.float32)


@cache
def compared() -> ChangeResult:
    return changes_between(page(), scan())


def of_reference(found: ChangeResult, at: tuple[float, float]) -> list[str | None]:
    """Return what happened to what is listed within 12 px of a place of the page."""
    return [
        change.what
        for change in found.summary.changes
        if np.hypot(change.reference_x_px - at[0], change.reference_y_px - at[1]) < 12
    ]


def test_a_word_that_is_missing_in_a_scan_is_found_beside_its_file() -> None:
    found = compared()
    assert of_reference(found, ERASED_PX) == ["gone"]
    assert of_reference(found, SPECK_PX) == ["new"]
    assert len(found.summary.changes) <= 3
    assert found.summary.compared_px > 0.7 * 520 * 420 * ZOOM**2


def test_a_page_is_flat_and_its_paper_is_no_highlight() -> None:
    summary = compared().summary
    assert summary.parallax is None
    assert summary.zoom == pytest.approx(1 / ZOOM, rel=1e-3)
    assert summary.saturated_px == 0
    assert not [text for text in summary.warnings if "gloss" in text]


def night() -> AnyArray:
    """Three lamps in the dark, which is nearly black, with noise that is mostly cut off at 0."""
    levels = np.rint(np.clip(np.random.default_rng(4).normal(-0.4, 0.8, (200, 300)), 0, None))
    levels[20:40, 40:60] = levels[90:110, 200:220] = levels[150:170, 100:120] = 255.0
    return levels


@pytest.mark.parametrize(
    ("image", "is_page"),
    [
        (page(), True),
        (scan(), False),
        (np.full((50, 50), 255.0), False),
        (np.tile(np.arange(256.0), (200, 1)), False),
        (night(), False),
    ],
)
def test_a_page_is_nearly_all_black_and_white(image: AnyArray, is_page: bool) -> None:
    assert is_of_two_levels(image) == is_page
