"""``standoff noise``: photon transfer and correction maps from dark and flat captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from standoff.terminal import (
    Force,
    Json,
    ShownProgress,
    print_json,
    print_table,
    refuse_overwriting,
    refuse_suffix,
    say,
)

if TYPE_CHECKING:
    from calibration.noise import NoiseMeasurement


def noise(
    *,
    session: Annotated[
        Path, typer.Option(help="Capture session with dark captures and a series of flats.")
    ],
    out: Annotated[
        Path, typer.Option(help="Where to write noise.json; the maps are written beside it.")
    ],
    report: Annotated[Path | None, typer.Option(help="Also write a report (HTML or PDF).")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure gain, read noise, black level, linearity and saturation, and map the sensor."""
    from calibration.documents import json_object
    from calibration.noise import map_paths
    from standoff.library import measure_noise, require_writable, write_noise

    refuse_suffix(out, "--out", {".json"})
    refuse_suffix(report, "--report", {".html", ".htm", ".pdf"})
    refuse_overwriting([out, *map_paths(out).values(), report], force=force)
    require_writable([out, report])
    found = measure_noise(session, report=report, progress=ShownProgress())
    written = write_noise(out, found)
    if json:
        print_json(json_object(written))
        return
    _print(found)
    maps = ", ".join(path.name for path in map_paths(out).values())
    say(f"wrote {out}, {maps}" + (f" and {report}" if report else ""))


def _print(found: NoiseMeasurement) -> None:
    from calibration.sharpness import NORMAL_95

    calibration, transfer, pixels = found.calibration, found.transfer, found.nonuniformity
    dark, saturation = transfer.dark, transfer.saturation
    rows = [
        [
            "gain / (e/DN)",
            f"{transfer.gain_e_per_dn:.4f}",
            f"{NORMAL_95 * transfer.gain_e_per_dn_err:.4f}",
        ],
        [
            "read noise / e",
            f"{transfer.read_noise_e:.3f}",
            f"{NORMAL_95 * transfer.read_noise_e_err:.3f}",
        ],
        [
            "black level / DN",
            f"{dark.black_level_dn:.3f}",
            f"{NORMAL_95 * dark.black_level_dn_err:.3f}",
        ],
        [
            "saturation / DN",
            f"{saturation.level_dn:.1f}",
            "not reached" if saturation.err_dn is None else f"{NORMAL_95 * saturation.err_dn:.1f}",
        ],
        ["saturation / e", f"{transfer.saturation_e:.0f}", ""],
    ]
    if dark.current_e_per_s is not None and dark.current_e_per_s_err is not None:
        rows.append(
            [
                "dark current / (e/s)",
                f"{dark.current_e_per_s:.2f}",
                f"{NORMAL_95 * dark.current_e_per_s_err:.2f}",
            ]
        )
    if transfer.linearity is not None:
        rows.append(["linearity error / %", f"{100 * transfer.linearity.mean_deviation:.3f}", ""])
    rows += [
        ["DSNU / e", f"{pixels.dsnu_dn * transfer.gain_e_per_dn:.2f}", ""],
        ["PRNU / %", f"{100 * pixels.prnu:.3f}", ""],
        ["shading / %", f"{100 * pixels.shading:.1f}", ""],
        ["defect pixels", str(pixels.defects), ""],
    ]
    print_table(
        f"Noise at {calibration.gain_db:g} dB" if calibration.gain_db is not None else "Noise",
        ["", "value", "± at 95 %"],
        rows,
    )
    say(
        f"{calibration.darks} dark and {calibration.flats} flat captures, fitted from "
        f"{transfer.fit_low_dn:.0f} to {transfer.fit_high_dn:.0f} DN"
    )
