"""A calibrated PSF as tables in the terminal."""

from pathlib import Path

from calibration.blind import is_clear
from calibration.psf import Estimate, PsfCalibration
from calibration.sharpness import NORMAL_95, with_reach
from standoff.terminal.output import note, print_table, say


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


def _cells(estimate: Estimate | None) -> list[str]:
    if estimate is None:
        return ["not determined", ""]
    return [f"{estimate.value:.4f}", f"{estimate.low:.4f} to {estimate.high:.4f}"]
