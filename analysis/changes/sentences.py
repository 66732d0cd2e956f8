"""What a comparison found, in sentences."""

from math import hypot, isfinite, sqrt

from analysis.changes.document import Change, ChangeSummary
from analysis.detection_limits import percent_text, prediction_sentence, spot_sentence

_NORMAL_95 = 1.96
_SURE = 3.0
"""Standard errors by which the blur must differ from none, to be said: of equal photographs, once
in 400 pairs."""


def describe_focus(found: ChangeSummary) -> str | None:
    """Say how far the follow-up's blur is from what was expected; None if nothing is known.

    With a calibration, what was expected is its blur at the follow-up's distance; without one, the
    reference's own.
    """
    value_px2, err_px2 = found.extra_blur_px2, found.extra_blur_err_px2
    if not isfinite(err_px2):
        return None
    figures = f"{value_px2:+.2f} ± {_NORMAL_95 * err_px2:.2g} px^2"
    if found.kernel == "pair" and abs(value_px2) <= _SURE * err_px2:
        return f"the follow-up is as sharp as the reference ({figures})"
    word = "softer" if value_px2 > 0 else "sharper"
    errors = f", {abs(value_px2) / err_px2:.0f} standard errors" if err_px2 > 0 else ""
    spread = f"{word} by a Gaussian of {sqrt(abs(value_px2)):.2f} px ({figures}{errors})"
    if found.kernel == "both":
        return f"the focus has changed: against psf.json and the pose, the follow-up is {spread}"
    if found.kernel == "pair":
        return f"against the reference, the follow-up is {spread}"
    return f"no change of focus: the blur is what psf.json and the pose explain ({figures})"


def describe_limit(found: ChangeSummary) -> str | None:
    """Say which spots would have been found; None in files of before."""
    if found.detection_limit is None:
        return None
    sentence = spot_sentence(found.detection_limit)
    if found.frame_px:
        left_out = 1 - found.compared_px / found.frame_px
        sentence += f"; {percent_text(left_out)} were not compared"
    return sentence


def describe_prediction(found: ChangeSummary) -> str | None:
    """Say how the limit and the predicted one compare; None where nothing was predicted."""
    limit = found.detection_limit
    if limit is None or limit.predicted is None:
        return None
    return prediction_sentence(limit.predicted)


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


def describe_least(found: ChangeSummary) -> str | None:
    """Say how many changes are too small to be listed; None if none is."""
    count = found.below_least
    if not count:
        return None
    what = "the step of the files' levels" if found.least_dn is None else f"{found.least_dn:g} DN"
    verb = "1 significant difference is" if count == 1 else f"{count} significant differences are"
    return f"{verb} smaller than {what} and not listed"
