"""What an operator should know about a calibration, in sentences."""

import numpy as np

from calibration.psf import USUAL_RHO, PsfCalibration, share_of_correlation

_WORTH_SAYING = 0.002
"""Smallest relative error of a width, from an unknown rho, that is worth a note."""

_REMARKS = {
    "sharpened": "overshoot on both sides of {n} of {total} edges: the camera sharpens, "
    "and sigma comes out too small; switch sharpening off",
    "jpeg": "{n} of {total} edges are from JPEG files, whose compression adds to the error",
    "non_gaussian": "{n} of {total} edges do not fit a Gaussian PSF; sigma is an equivalent width",
}

_FEW_USED = 0.25
"""Of a target most edges are used; of a scene few are clean, and they disagree."""

_NO_TARGET = ("uneven", "too_noisy", "curved")
"""Flags of a border in a scene."""

_OVER_HEIGHTS = ("soft_target", "focus_drift", "focus_scatter")
"""Named causes of widths that differ between heights, which say more than the trend."""


def psf_remarks(calibration: PsfCalibration) -> list[str]:
    """Say what is wrong with the edges of a target, and what they do not determine."""
    said = []
    used = calibration.edges_used
    for flag, text in _REMARKS.items():
        count = sum(flag in edge.flags for edge in used)
        if count:
            said.append(text.format(n=count, total=len(used)))
    if _shows_no_target(calibration):
        said.append(
            f"only {len(used)} of the {len(calibration.edges)} edges found can be used: if this is "
            "a photograph of a scene without an edge target, its edges may themselves be soft; "
            "photograph a printed edge, or the scene from two distances (--method two-distance); "
            "--method single-image estimates from one photograph, to some 20 %"
        )
    missing = _what_is_missing(calibration) if used else None
    if missing is not None:
        said.append(missing)
    named = () if calibration.cross_validation is None else calibration.cross_validation.named
    said.extend(one.sentence for one in named)
    trend = calibration.height_trend
    is_explained = any(one.kind in _OVER_HEIGHTS for one in named)
    if trend is not None and trend.is_drift and not is_explained:
        said.append(
            f"the width changes by {100 * trend.change:.1f} % over the heights: the focus drifts, "
            "or the target is too rough for the nearest height; calibrate at one height or refocus"
        )
    return said


def _shows_no_target(calibration: PsfCalibration) -> bool:
    """Whether most edges that were found look like those of a scene."""
    used, edges = calibration.edges_used, calibration.edges
    if not used or len(used) >= _FEW_USED * len(edges):
        return False
    of_scene = sum(any(flag in _NO_TARGET for flag in edge.flags) for edge in edges)
    return of_scene > len(edges) / 2


def _what_is_missing(calibration: PsfCalibration) -> str | None:
    """Say in one line what the directions of the edges do not determine, and the remedy."""
    missing = [
        text
        for value, text in (
            (calibration.sigma_x_px, "sigma_x"),
            (calibration.sigma_y_px, "sigma_y"),
            (calibration.rho, "rho"),
        )
        if value is None
    ]
    if not missing or calibration.method == "paper":  # which never determines rho
        return None
    used = calibration.edges_used
    if len(used) == 1:
        missing.append("the change over the frame")
    *first, last = missing
    listed = f"{', '.join(first)} and {last}" if first else last
    text = f"not determined by {len(used)} edge{'s' * (len(used) > 1)}: {listed}"
    share = share_of_correlation(np.array([edge.angle_deg for edge in used]))
    if calibration.rho is None and share * USUAL_RHO > _WORTH_SAYING:
        text += (
            f"; if rho were {USUAL_RHO:g}, a width would be off by "
            f"{100 * share * USUAL_RHO:.1f} %, beyond its interval"
        )
    needed = "in other directions" if len(missing) > 1 else "that are diagonal"
    return f"{text}; add edges {needed}"
