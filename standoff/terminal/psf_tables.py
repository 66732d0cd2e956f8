"""A calibrated PSF as tables in the terminal."""

from pathlib import Path

import numpy as np

from calibration.blind import is_clear
from calibration.psf import Estimate, PsfCalibration, share_of_correlation
from calibration.sharpness import NORMAL_95, with_reach
from standoff.terminal.output import note, print_table, say

_USUAL_RHO = 0.1
_WORTH_SAYING = 0.002
"""Smallest relative error of a width, from an unknown rho, that is worth a note."""

_REMARKS = {
    "sharpened": "overshoot on both sides of {n} of {total} edges: the camera sharpens, "
    "and sigma comes out too small; switch sharpening off",
    "jpeg": "{n} of {total} edges are from JPEG files, whose compression adds to the error",
    "non_gaussian": "{n} of {total} edges do not fit a Gaussian PSF; sigma is an equivalent width",
}


def print_psf(calibration: PsfCalibration) -> None:
    """Print widths and correlation, and what they are based on."""
    _print_source(calibration)
    total, optical = calibration.total, calibration.optical
    print_table(
        "PSF",
        ["", "total", "95 % interval", "optical", "95 % interval"],
        [
            [name, *_cells(with_pixel), *_cells(lens)]
            for name, with_pixel, lens in (
                ("sigma_x / px", total.sigma_x_px, optical.sigma_x_px),
                ("sigma_y / px", total.sigma_y_px, optical.sigma_y_px),
                ("rho", total.rho, optical.rho),
            )
            if with_pixel is not None
        ],
    )
    if calibration.transfer_2d is not None:
        say(f"measured transfer: {calibration.transfer_2d}")
    if calibration.channels is not None:
        print_table(
            "Colours",
            ["", "total sigma_x / px", "total sigma_y / px", "edges"],
            [
                [
                    name,
                    _cells(one.total.sigma_x_px)[0],
                    _cells(one.total.sigma_y_px)[0],
                    "" if one.edge_count is None else str(one.edge_count),
                ]
                for name, one in calibration.channels.items()
            ],
        )
    if calibration.field is not None and calibration.field.worst_err is not None:
        say(
            "the PSF changes over the frame: psf.json holds its field, with every width known to "
            f"± {100 * NORMAL_95 * calibration.field.worst_err:.1f} % (95 %) or better"
        )
    if calibration.softness_px2 is not None:
        softness_px = calibration.softness_px2**0.5
        say(f"the scene's own edges have a mean blur of {softness_px:.2f} px")
        note(
            "one image cannot tell a soft scene from a soft lens; the intervals assume a scene "
            "with edges sharper than a pixel; --method two-distance does better"
        )


def _print_source(calibration: PsfCalibration) -> None:
    """Print the pairs, or how many edges counted."""
    if calibration.pairs:
        print_table(
            "Pairs, ± at 95 %",
            ["near", "far", "zoom", "sigma_x / px", "sigma_y / px"],
            [
                [
                    Path(pair.near).name,
                    Path(pair.far).name,
                    f"{pair.zoom:.4f}",
                    with_reach(pair.sigma_x_px, NORMAL_95 * pair.sigma_x_err_px, 4),
                    with_reach(pair.sigma_y_px, NORMAL_95 * pair.sigma_y_err_px, 4),
                ]
                for pair in calibration.pairs
            ],
        )
    elif calibration.softness_px2 is not None:
        clear = sum(is_clear(edge) for edge in calibration.edges)
        say(f"{clear} of {len(calibration.edges)} edges are clear enough")
    else:
        say(f"{len(calibration.edges_used)} of {len(calibration.edges)} edges used")


def print_psf_remarks(calibration: PsfCalibration) -> None:
    """Note what is wrong with the edges of a target, and what they do not determine."""
    used = calibration.edges_used
    for flag, text in _REMARKS.items():
        count = sum(flag in edge.flags for edge in used)
        if count:
            note(text.format(n=count, total=len(used)))
    if used:
        _note_what_is_missing(calibration)
    trend = calibration.height_trend
    if trend is not None and trend.is_drift:
        note(
            f"the width changes by {100 * trend.change:.1f} % over the heights: the focus drifts, "
            "or the target is too rough for the nearest height; calibrate at one height or refocus"
        )


def _note_what_is_missing(calibration: PsfCalibration) -> None:
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
        return
    used = calibration.edges_used
    if len(used) == 1:
        missing.append("the change over the frame")
    *first, last = missing
    listed = f"{', '.join(first)} and {last}" if first else last
    text = f"not determined by {len(used)} edge{'s' * (len(used) > 1)}: {listed}"
    share = share_of_correlation(np.array([edge.angle_deg for edge in used]))
    if calibration.rho is None and share * _USUAL_RHO > _WORTH_SAYING:
        text += (
            f"; if rho were {_USUAL_RHO:g}, a width would be off by "
            f"{100 * share * _USUAL_RHO:.1f} %, beyond its interval"
        )
    needed = "in other directions" if len(missing) > 1 else "that are diagonal"
    note(f"{text}; add edges {needed}")


def _cells(estimate: Estimate | None) -> list[str]:
    if estimate is None:
        return ["not determined", ""]
    return [f"{estimate.value:.4f}", f"{estimate.low:.4f} to {estimate.high:.4f}"]
