"""What is said of doubtful changes, on masks drawn by hand."""

import numpy as np
import pytest

from analysis.changes.document import Change
from analysis.changes.filter import ChangeMasks, change_warnings
from analysis.detection_limits import level_text
from simulation.arrays import BoolArray

SHAPE = (200, 300)
NONE = np.zeros(SHAPE, dtype=np.bool_)


def block(rows: slice, cols: slice) -> BoolArray:
    mask = NONE.copy()
    mask[rows, cols] = True
    return mask


INNER = block(slice(10, 190), slice(10, 290))


def masks(
    is_change: BoolArray = NONE,
    valid: BoolArray = INNER,
    clipped: BoolArray = NONE,
    reference_clipped: BoolArray = NONE,
) -> ChangeMasks:
    return ChangeMasks(
        is_change=is_change & valid,
        valid=valid,
        clipped=clipped,
        reference_clipped=reference_clipped,
    )


def change(y_px: float, x_px: float, amplitude_dn: float) -> Change:
    return Change(
        x_px=x_px,
        y_px=y_px,
        reference_x_px=x_px,
        reference_y_px=y_px,
        area_px=20.0,
        amplitude_dn=amplitude_dn,
        amplitude_err_dn=1.0,
        significance=20.0,
        q_value=1e-9,
    )


def test_an_ordinary_change_is_not_doubted() -> None:
    inside = block(slice(80, 90), slice(100, 112))
    at_border = block(slice(11, 20), slice(100, 112))
    for mask in (NONE, inside, at_border):
        assert change_warnings([change(85, 106, 9.0)], masks(mask)) == ()


def test_a_strip_along_a_border_is_named_with_its_side() -> None:
    (left,) = change_warnings([], masks(block(slice(10, 190), slice(10, 13))))
    assert "line the left of" in left
    (two,) = change_warnings(
        [], masks(block(slice(10, 14), slice(10, 290)) | block(slice(12, 188), slice(287, 290)))
    )
    assert "line the top and right of" in two


def test_changes_beside_a_masked_hole_are_no_border() -> None:
    hole = block(slice(60, 140), slice(80, 200))
    ring = block(slice(57, 143), slice(77, 203)) & ~hole
    assert change_warnings([], masks(ring, valid=INNER & ~hole)) == ()


def test_a_highlight_in_one_photograph_alone_is_likely_gloss() -> None:
    gloss = block(slice(50, 58), slice(60, 70))
    hidden = INNER & ~block(slice(45, 63), slice(55, 75))
    (said,) = change_warnings([], masks(valid=hidden, clipped=gloss))
    assert "1 in the follow-up alone" in said
    assert "gloss" in said
    (said,) = change_warnings([], masks(valid=hidden, reference_clipped=gloss))
    assert "1 in the reference alone" in said
    # What both show clipped is part of the scene.
    assert change_warnings([], masks(clipped=gloss, reference_clipped=np.roll(gloss, 2))) == ()


def test_changes_on_the_rim_of_a_highlight_are_counted() -> None:
    gloss = block(slice(50, 58), slice(60, 70))
    changes = [change(54, 75, 9.0), change(54, 76, -9.0), change(150, 200, 9.0)]
    (said,) = change_warnings(changes, masks(clipped=gloss))
    assert "1 of 3 changes lie beside clipped pixels" in said


def test_a_large_overexposed_part_is_no_gloss() -> None:
    assert change_warnings([], masks(clipped=block(slice(0, 100), slice(0, 200)))) == ()


def test_a_small_overlap_is_said_with_its_share() -> None:
    (said,) = change_warnings([], masks(valid=block(slice(0, 100), slice(0, 120))))
    assert "only 20 % of the follow-up" in said


def test_no_overlap_at_all_has_a_sentence_too() -> None:
    assert len(change_warnings([], masks(valid=NONE))) == 1


@pytest.mark.parametrize(
    ("level_dn", "text"), [(4.68, "4.7"), (102.4, "100"), (1380.0, "1400"), (0.034, "0.034")]
)
def test_levels_have_two_digits_and_no_exponent(level_dn: float, text: str) -> None:
    assert level_text(level_dn) == text
