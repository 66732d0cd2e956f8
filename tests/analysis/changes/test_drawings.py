"""Drawings of two levels: scanned twice, on another grid of pixels, in files that lose some."""

from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import standoff
from calibration.errors import CalibrationError
from hil_mocks.benchmark_set._documents import benchmark_tasks
from hil_mocks.benchmark_set._things import ThingsPair

Levels = NDArray[np.uint8]


def boards(seed: int, *, erased: bool = False) -> Levels:
    """Black bars on white, on twice as fine a grid, and a disc beside them that may be erased."""
    rng = np.random.default_rng(seed)
    fine = np.full((520, 640), 255, np.uint8)
    bars = [(*rng.integers((60, 60), (560, 440)), *rng.integers(4, 60, 2)) for _ in range(50)]
    for x, y, wide, high in bars:
        cv2.rectangle(fine, (int(x), int(y)), (int(x + wide), int(y + high)), 0, -1)
    cv2.circle(fine, (320, 40), 10, 255 if erased else 0, -1)
    return fine


def scanned(fine: Levels, turn_deg: float = 0.0, shift_px: tuple[float, float] = (0, 0)) -> Levels:
    """Half as many pixels of a sheet that lies a little askew, each either black or white."""
    matrix = cv2.getRotationMatrix2D((320.0, 260.0), turn_deg, 1.0)
    matrix[:, 2] += 2 * np.array(shift_px)
    soft = cv2.GaussianBlur(fine.astype(np.float32), (0, 0), 1.0)
    laid = cv2.warpAffine(soft, matrix, (640, 520), borderMode=cv2.BORDER_REPLICATE)
    return np.where(laid[20:-20:2, 20:-20:2] > 127, 255, 0).astype(np.uint8)


def written(folder: Path, *drawings: Levels, quality: int | None = None) -> list[Path]:
    paths = [folder / f"{at}{'.png' if quality is None else '.jpg'}" for at in range(len(drawings))]
    for path, levels in zip(paths, drawings, strict=True):
        file = BytesIO()
        if quality is None:
            Image.fromarray(levels).save(file, "PNG")
        else:
            Image.fromarray(levels).save(file, "JPEG", quality=quality)
        path.write_bytes(file.getvalue())
    return paths


@pytest.mark.parametrize("seed", [1, 2, 3, 5])
def test_a_sheet_that_is_scanned_again_askew_has_no_change(seed: int, tmp_path: Path) -> None:
    """Outlines step from pixel to pixel elsewhere; along a bar that is a strip of one pixel."""
    fine = boards(seed)
    pair = written(tmp_path, scanned(fine), scanned(fine, 0.5, (1.6, -1.1)))
    found = standoff.find_changes(*pair).summary
    assert found.changes == ()
    assert found.moved == ()


@pytest.mark.parametrize("quality", [None, 75])
def test_what_was_erased_before_the_second_scan_is_the_one_entry(
    quality: int | None, tmp_path: Path
) -> None:
    pair = written(
        tmp_path,
        scanned(boards(2)),
        scanned(boards(2, erased=True), 0.5, (1.6, -1.1)),
        quality=quality,
    )
    found = standoff.find_changes(*pair).summary
    [change] = found.changes
    # The disc at (320, 40) of the finer grid, 20 of which are cut off and half of which are pixels.
    assert change.reference_x_px == pytest.approx(150, abs=1.5)
    assert change.reference_y_px == pytest.approx(10, abs=1.5)


def test_two_scans_of_a_sheet_have_no_change_where_they_have_no_variance(tmp_path: Path) -> None:
    """Wide white parts differ by what floats round, which has to be no infinite significance."""
    [task] = [
        task
        for task in benchmark_tasks("tiny", 1)
        if isinstance(task, ThingsPair) and task.kind == "two-level" and not task.is_changed
    ]
    made = task.rendered()
    pair = [tmp_path / f"{of}.png" for of in ("reference", "followup")]
    for path in pair:
        path.write_bytes(made.files[made.task[path.stem]])
    assert standoff.find_changes(*pair).summary.changes == ()


def lines(*, drawn_anew: bool) -> Levels:
    """Long lines with few interruptions, of which one is new; drawn anew each is a pixel off."""
    sheet = np.full((240, 300), 255, np.uint8)
    for number, row in enumerate(range(30, 230, 40)):
        top = row + (number % 2 if drawn_anew else 0)
        sheet[top : top + 8] = 0
    sheet[150:160, 180:188] = sheet[70:80, 250:256] = 255
    if drawn_anew:
        sheet[108:120, 100:112] = 255
    return sheet


def test_drawings_of_long_lines_that_nothing_aligns_are_compared_as_they_lie(
    tmp_path: Path,
) -> None:
    pair = written(tmp_path, lines(drawn_anew=False), lines(drawn_anew=True))
    [change] = standoff.find_changes(*pair).summary.changes
    assert (change.x_px, change.y_px) == pytest.approx((105.5, 114), abs=1.5)
    other = written(tmp_path, lines(drawn_anew=False), scanned(boards(1)))
    with pytest.raises(CalibrationError, match="no pose was found"):
        standoff.find_changes(*other)
