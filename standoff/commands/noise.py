"""``standoff noise``: photon transfer and correction maps from darks and flats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from standoff import library, terminal

if TYPE_CHECKING:
    from calibration.noise import NoiseMeasurement


_FRAMES = "a folder, a pattern such as 'flats/*.tif', or a file with a stack"


@terminal.command(
    terminal.exactly_one("session", "flat"),
    terminal.needs("flat", "dark"),
    *(
        terminal.needs(option, "flat")
        for option in ("dark", "dark_exposures_us", "flat_exposures_us", "encoding", "white_level")
    ),
)
def noise(
    *,
    session: Annotated[Path | None, Option(metavar="FOLDER")] = None,
    dark: Annotated[
        list[Path] | None,
        Option(
            help=f"Your own dark frames: {_FRAMES}; repeat for each exposure. A folder of folders "
            "holds several exposures.",
            metavar="FRAMES",
        ),
    ] = None,
    flat: Annotated[list[Path] | None, Option(metavar="FRAMES")] = None,
    dark_exposures_us: Annotated[list[float] | None, Option("--dark-exposure-us")] = None,
    flat_exposures_us: Annotated[list[float] | None, Option("--flat-exposure-us")] = None,
    encoding: terminal.EncodingName = "auto",
    white_level: Annotated[float | None, Option(min=1e-6, metavar="N")] = None,
    out: Annotated[Path, terminal.Result(".json")],
    report: Annotated[Path | None, terminal.REPORT] = None,
) -> None:
    """Measure gain, read noise, black level, linearity and saturation, and map the sensor.

    Options
    -------
    session: Capture session with dark captures and a series of flats.
    flat: Frames of an evenly lit white surface, given in the same way, at three or more levels.
    dark_exposures_us: Exposure of each dark level, in order; by default as EXIF or FITS states.
    flat_exposures_us: The same for the flats.
    white_level: Level at which the frames are clipped; by default as the files state.
    out: Where to write noise.json; the maps are written beside it.
    report: Also write a report (HTML or PDF).
    """
    from calibration.noise import map_paths

    maps = map_paths(out).values()
    terminal.refuse_replacing(*maps)
    how = terminal.keywords_of(
        library.measure_noise,
        darks=_frames(dark),
        flats=_frames(flat),
        reading=None if session else terminal.reading_options(encoding),
    )
    found = library.measure_noise(session, **how)
    written = library.write_noise(out, found)
    named = f"{out}, {', '.join(path.name for path in maps)}"
    wrote = f"wrote {named}" + (f" and {report}" if report else "")
    terminal.answer(written, lambda: _print(found, wrote))


def _frames(paths: list[Path] | None) -> Path | list[Path] | None:
    """One path, which may hold several levels, or a level for each."""
    return paths[0] if paths is not None and len(paths) == 1 else paths or None


def _print(found: NoiseMeasurement, wrote: str) -> None:
    from calibration.estimate import NORMAL_95

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
        f"{transfer.fit_low_dn:.0f} to {transfer.fit_high_dn:.0f} DN",
        wrote,
    )
