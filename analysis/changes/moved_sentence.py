"""What moved between two photographs, in a sentence."""

from math import hypot

from analysis.changes.document import Change, ChangeSummary


def describe_moved(found: ChangeSummary) -> str | None:
    """Say how many changes a shift explains; None if it explains none."""
    moved = found.moved
    if not moved:
        return None
    furthest = max(map(_distance_px, moved))
    what = "1 change is" if len(moved) == 1 else f"{len(moved)} changes are"
    how_far = "by" if len(moved) == 1 else "by up to"
    return (
        f"{what} listed apart: what was there before lies elsewhere now, {how_far} "
        f"{furthest:.1f} px ({found.moved_px} pixels)"
    )


def _distance_px(change: Change) -> float:
    return 0.0 if change.displacement_px is None else hypot(*change.displacement_px)
