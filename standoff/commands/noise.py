"""``standoff noise``: photon transfer and correction maps from darks and flats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Context, Option

from standoff import library, terminal

if TYPE_CHECKING:
    from calibration.noise import NoiseMeasurement


_FRAMES = "a folder, a pattern such as 'flats/*.tif', or a file with a stack"
_RULES = (
    terminal.exactly_one("session", "flat"),
    terminal.needs("flat", "dark"),
    *(
        terminal.needs(option, "flat")
        for option in ("dark", "dark_exposure_us", "flat_exposure_us", "encoding", "white_level")
    ),
)


def noise(
    context: Context,
    *,
    session: Annotated[
        Path | None,
        Option(help="Capture session with dark captures and a series of flats.", metavar="FOLDER"),
    ] = None,
    dark: Annotated[
        list[Path] | None,
        Option(
            help=f"Dark frames of one's own: {_FRAMES}; again for another exposure. A folder of "
            "folders is several.",
            metavar="FRAMES",
        ),
    ] = None,
    flat: Annotated[
        list[Path] | None,
        Option(
            help="Frames of an even white, likewise, at three levels or more.", metavar="FRAMES"
        ),
    ] = None,
    dark_exposure_us: Annotated[
        list[float] | None,
        Option(help="Exposure of each level of darks in turn; by default as EXIF or FITS states."),
    ] = None,
    flat_exposure_us: Annotated[list[float] | None, Option(help="The same of the flats.")] = None,
    encoding: terminal.EncodingName = "auto",
    white_level: Annotated[
        float | None,
        Option(
            min=1e-6,
            metavar="N",
            help="Level of the frames at which they are clipped; the files' own by default.",
        ),
    ] = None,
    out: Annotated[Path, Option(help="Where to write noise.json; the maps are written beside it.")],
    report: Annotated[Path | None, Option(help="Also write a report (HTML or PDF).")] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Measure gain, read noise, black level, linearity and saturation, and map the sensor."""
    from calibration.noise import map_paths

    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(out, "--out", {".json"})
    terminal.refuse_suffix(report, "--report", terminal.REPORTS)
    given = [*(dark or []), *(flat or [])]
    terminal.refuse_overwriting([out, *map_paths(out).values(), report], given, force=force)
    library.require_writable([out, report])
    found = library.measure_noise(
        session,
        darks=_frames(dark),
        flats=_frames(flat),
        dark_exposures_us=dark_exposure_us or None,
        flat_exposures_us=flat_exposure_us or None,
        white_level=white_level,
        report=report,
        reading=None if session else terminal.reading_options(encoding, None, False, None),
        progress=terminal.ShownProgress(),
    )
    written = library.write_noise(out, found)
    if json:
        terminal.print_json(written)
        return
    _print(found)
    maps = ", ".join(path.name for path in map_paths(out).values())
    terminal.say(f"wrote {out}, {maps}" + (f" and {report}" if report else ""))


def _frames(paths: list[Path] | None) -> Path | list[Path] | None:
    """One path, which may hold several levels, or a level for each."""
    return paths[0] if paths is not None and len(paths) == 1 else paths or None


def _print(found: NoiseMeasurement) -> None:
    from calibration.sharpness import NORMAL_95

    calibration, transfer, pixels = found.calibration, found.transfer, found.nonuniformity
    dark, saturation = transfer.dark, transfer.saturation
    cells = terminal.value_cells
    limit = "not reached" if saturation.err_dn is None else f"{NORMAL_95 * saturation.err_dn:.1f}"
    rows = [
        ["gain / (e/DN)", *cells(transfer.gain_e_per_dn, transfer.gain_e_per_dn_err, 4)],
        ["read noise / e", *cells(transfer.read_noise_e, transfer.read_noise_e_err, 3)],
        ["black level / DN", *cells(dark.black_level_dn, dark.black_level_dn_err, 3)],
        ["saturation / DN", f"{saturation.level_dn:.1f}", limit],
        ["saturation / e", f"{transfer.saturation_e:.0f}", ""],
    ]
    current, current_err = dark.current_e_per_s, dark.current_e_per_s_err
    if current is not None and current_err is not None:
        rows.append(["dark current / (e/s)", *cells(current, current_err, 2)])
    if transfer.linearity is not None:
        rows.append(["linearity error / %", f"{100 * transfer.linearity.mean_deviation:.3f}", ""])
    rows += [
        ["DSNU / e", f"{calibration.dsnu_e:.2f}", ""],
        ["PRNU / %", f"{100 * pixels.prnu:.3f}", ""],
        ["shading / %", f"{100 * pixels.shading:.1f}", ""],
        ["defect pixels", str(pixels.defects), ""],
    ]
    terminal.print_table(
        f"Noise at {calibration.gain_db:g} dB" if calibration.gain_db is not None else "Noise",
        ["", "value", "± at 95 %"],
        rows,
    )
    terminal.say(
        f"{calibration.darks} dark and {calibration.flats} flat captures, fitted from "
        f"{transfer.fit_low_dn:.0f} to {transfer.fit_high_dn:.0f} DN"
    )
