"""A calibrated PSF as tables in the terminal."""

from pathlib import Path

from calibration.blind import is_clear
from calibration.psf import Estimate, PsfCalibration
from standoff.terminal.output import note, print_table, say

__all__ = ["print_psf"]


def print_psf(calibration: PsfCalibration) -> None:
    """Print widths and correlation, and what they rest on."""
    if calibration.pairs:
        print_table(
            "Pairs",
            ["near", "far", "zoom", "sigma_x / px", "sigma_y / px"],
            [
                [
                    Path(pair.near).name,
                    Path(pair.far).name,
                    f"{pair.zoom:.4f}",
                    f"{pair.sigma_x_px:.4f} ± {pair.sigma_x_err_px:.4f}",
                    f"{pair.sigma_y_px:.4f} ± {pair.sigma_y_err_px:.4f}",
                ]
                for pair in calibration.pairs
            ],
        )
    elif calibration.softness_px2 is not None:
        clear = sum(is_clear(edge) for edge in calibration.edges)
        say(f"{clear} of {len(calibration.edges)} edges are clear enough")
    else:
        say(f"{len(calibration.edges_used)} of {len(calibration.edges)} edges used")
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
        ],
    )
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
            "the PSF changes over the frame: psf.json holds its field, no width less sure than "
            f"{100 * calibration.field.worst_err:.1f} %"
        )
    if calibration.softness_px2 is not None:
        softness_px = calibration.softness_px2**0.5
        say(f"the scene's own edges are soft by {softness_px:.2f} px on average")
        note(
            "one image cannot tell a soft scene from a soft lens; the intervals hold for a scene "
            "with edges sharper than a pixel; --method two-distance does better"
        )


def _cells(estimate: Estimate | None) -> list[str]:
    if estimate is None:
        return ["not determined", ""]
    return [f"{estimate.value:.4f}", f"{estimate.low:.4f} to {estimate.high:.4f}"]
