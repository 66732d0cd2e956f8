"""What the blur between two photographs says of their focus, in a sentence."""

from math import sqrt

from analysis.changes.document import ChangeSummary

_SURE = 3.0
"""Standard errors from which a difference of blur is said to be one."""


def describe_focus(found: ChangeSummary) -> str | None:
    """Say how far the follow-up's blur is from what was expected; None if nothing is known.

    With a calibration, what was expected is its blur at the follow-up's distance; without one, the
    reference's own.
    """
    value_px2, err_px2 = found.extra_blur_px2, found.extra_blur_err_px2
    if not 0 < err_px2 < float("inf"):
        return None
    is_calibrated = found.kernel != "pair"
    expected = "psf.json and the pose explain" if is_calibrated else "the reference"
    errors = abs(value_px2) / err_px2
    if errors < _SURE:
        return (
            f"the follow-up is as sharp as {expected} (to {2 * err_px2:.2g} px^2)"
            if not is_calibrated
            else f"the focus has not changed: the blur is what {expected} (to {2 * err_px2:.2g} "
            "px^2)"
        )
    word = "softer" if value_px2 > 0 else "sharper"
    figures = (
        f"a Gaussian of {sqrt(abs(value_px2)):.2f} px ({value_px2:+.2f} ± {2 * err_px2:.2g} px^2, "
        f"{errors:.0f} standard errors)"
    )
    if is_calibrated:
        return f"the focus has changed: the follow-up is {word} than {expected} by {figures}"
    return f"the follow-up is {word} than {expected} by {figures}"
