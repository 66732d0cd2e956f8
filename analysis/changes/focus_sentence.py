"""What the blur between two photographs says of their focus, in a sentence."""

from math import isfinite, sqrt

from analysis.changes.document import ChangeSummary

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
