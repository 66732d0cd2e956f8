"""A calibrated PSF as tables in the terminal."""

from pathlib import Path

from calibration.blind import CLEAREST_SNR
from calibration.psf import Estimate, PsfCalibration
from standoff.terminal.output import note, print_table, say

__all__ = ["print_psf"]


def print_psf(calibration: PsfCalibration) -> None:
    """Print widths and correlation, and what they rest on."""
    used = calibration.edges_used
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
        clear = sum(edge.fit.snr >= CLEAREST_SNR for edge in calibration.edges)
        say(f"{clear} of {len(calibration.edges)} edges are clear enough")
    else:
        say(f"{len(used)} of {len(calibration.edges)} edges used")
    print_table(
        "PSF",
        ["", "total", "95 % interval", "optical", "95 % interval"],
        [
            [name, *_cells(total), *_cells(optical)]
            for name, total, optical in (
                ("sigma_x / px", calibration.sigma_x_px, calibration.optical_sigma_x_px),
                ("sigma_y / px", calibration.sigma_y_px, calibration.optical_sigma_y_px),
                ("rho", calibration.rho, calibration.optical_rho),
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
                    _cells(one.sigma_x_px)[0],
                    _cells(one.sigma_y_px)[0],
                    str(len(one.edges_used)),
                ]
                for name, one in calibration.channels.items()
            ],
        )
    if calibration.field is not None:
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
