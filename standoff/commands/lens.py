"""``standoff lens``: the report of a lens and its camera, as a laboratory hands it over."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

from calibration.choices import Pattern
from calibration.estimate import NORMAL_95, with_reach
from standoff import library, terminal

if TYPE_CHECKING:
    from calibration.edges import Region
    from calibration.lens import LensMeasurement, ThroughFocus
    from calibration.sharpness import MeasuredValue

_FRAMES = "a folder, a pattern such as 'flats/*.tif', or a file with a stack"
_POSITIONS = terminal.ListedNumbers(option="--focus-mm", least=-inf, may_repeat=True)


@terminal.command(
    terminal.exactly_one("images", "session"),
    terminal.excludes("session", "dark", "flat", because="a session has its own"),
    terminal.excludes("session", "bayer", because="captures are linear and grey"),
    terminal.needs("dark", "flat"),
    terminal.needs("flat", "dark"),
    terminal.excludes("noise", "dark", "flat"),
    terminal.excludes("session", "focus_mm", because="a session has its own heights"),
    terminal.excludes("session", "leaves", because="a session shows edges, darks and flats"),
    suffixes_last=True,
)
def lens(
    images: list[Path] | None = None,
    *,
    out: Annotated[Path, terminal.REPORT],
    session: Path | None = None,
    dark: Annotated[
        list[Path] | None,
        Option(
            help=f"Dark frames of the same camera at the same gain: {_FRAMES}; repeat for each "
            "exposure. A folder of folders holds several exposures.",
            metavar="FRAMES",
        ),
    ] = None,
    flat: Annotated[list[Path] | None, Option(metavar="FRAMES")] = None,
    noise: Path | None = None,
    region: str | None = None,
    bayer: Pattern | None = None,
    focus_mm: Annotated[str | None, Option(metavar="MM,...")] = None,
    depth_contrast: Annotated[float, Option(metavar="C")] = 0.2,
    depth_freq_cy_per_px: Annotated[float, Option("--depth-frequency", metavar="CY/PX")] = 0.25,
    leaves: Path | None = None,
    reading: terminal.Reading,
    pixel_pitch_um: terminal.PixelPitch = None,
    labels: terminal.Labels,
    bench: Path | None = None,
    limits: Path | None = None,
) -> None:
    """Measure a lens and its camera, and write the report that a laboratory hands over.

    It contains sharpness in all colours, sharpening, lateral chromatic aberration, noise-equivalent
    quanta and information; with darks and flats, also the EMVA 1288 data sheet; with photographs
    through focus, also focus over the field and depth of field. A table (CSV) and a document (JSON)
    of all figures are written beside the report.

    Options
    -------
    images: Photographs of straight edges.
    out: Where to write the report (HTML or PDF).
    session: Capture session whose edge, dark and flat captures are used.
    flat: Frames of an evenly lit white surface, given in the same way, at three or more levels.
    noise: noise.json of the camera, instead of darks and flats; it gives no EMVA 1288 data sheet.
    region: Part of the image to use: centre, or X,Y,W,H in px; all of it by default.
    bayer: Bayer pattern of raw mosaics whose files do not state it.
    focus_mm: Focus positions of the photographs in mm, in the same order: at least five different
        ones, on both sides of the focus.
    depth_contrast: Contrast for which the depth of focus (for heights, the depth of field) is
        stated.
    depth_freq_cy_per_px: Frequency of that contrast, in cycles per pixel.
    leaves: Picture of the dead leaves target (spilled coins) that the photographs show: texture is
        then measured, too; edges beside it are needed.
    bench: Bench file (TOML) with the names for the report (table labels) and the pixel pitch (table
        optics).
    limits: Limits for pass and fail (TOML); the exit status is 0 even if a limit is not met.
    """
    table, document = out.with_suffix(".csv"), out.with_suffix(".json")
    terminal.refuse_replacing(table, document)
    how = terminal.keywords_of(
        library.measure_lens,
        darks=_frames(dark),
        flats=_frames(flat),
        region=_region(region),
        focus_mm=None if focus_mm is None else terminal.number_list(focus_mm, _POSITIONS),
        report=out,
    )
    found = library.measure_lens(
        (images or ()) if session is None else library.Session(session), **how
    )
    library.write_lens(document, found)
    library.write_lens(table, found)
    terminal.answer(
        found.to_json,
        lambda: _show(found, f"wrote {out}, {document.name}, {table.name}"),
        found.notes,
    )


def _frames(paths: list[Path] | None) -> Path | list[Path] | None:
    """One path, which may hold several levels, or a level for each."""
    return paths[0] if paths is not None and len(paths) == 1 else paths or None


def _region(text: str | None) -> Region | Literal["centre"] | None:
    if text is None:
        return None
    if text in ("centre", "center"):
        return "centre"
    from calibration.edges import Region

    return terminal.parsed_region(text, "centre or X,Y,W,H in px", Region)


_ROWS = (
    ("MTF50 / (cy/px)", "mtf50_cy_per_px", 4),
    ("MTF50P / (cy/px)", "mtf50p_cy_per_px", 4),
    ("MTF20 / (cy/px)", "mtf20_cy_per_px", 4),
    ("MTF10 / (cy/px)", "mtf10_cy_per_px", 4),
    ("contrast at half Nyquist", "mtf_at_half_nyquist", 4),
    ("contrast at Nyquist", "mtf_at_nyquist", 4),
    ("edge rise, 10 to 90 % / px", "rise_px", 3),
)


def _show(found: LensMeasurement, wrote: str) -> None:
    rows = [
        [label, *(_cell(getattr(one.median, name), digits) for one in found.colours)]
        for label, name, digits in _ROWS
    ]
    rows.append(["edges", *(str(one.edges) for one in found.colours)])
    terminal.print_table(
        "Medians over the edges, ± at 95 %", ["", *(one.colour for one in found.colours)], rows
    )
    if found.sharpening is not None:
        terminal.say(found.sharpening.sentence)
    for shift in found.lateral_colour:
        terminal.say(
            f"largest shift of {shift.colour} from green: {_cell(shift.shift_px, 3)} px at "
            f"({shift.x_px:.0f}, {shift.y_px:.0f})"
        )
    for field in found.lateral_fields:
        terminal.say(f"over the field, {field.sentence}")
    for texture in found.textures:
        half = _cell(texture.figures.mtf50_cy_per_px, 4) or "none"
        terminal.say(f"dead leaves: MTF50 {half} cy/px. {texture.sentence}")
    if found.through_focus is not None:
        _show_focus(found.through_focus)
    capacity = found.capacity
    if capacity is not None:
        disc = capacity.detection[1]
        terminal.say(
            f"information: {capacity.bits_per_px.estimate.text(2)} bits/px between levels "
            f"{capacity.range_dn:.0f} DN apart; an ideal observer just sees a {disc.description} "
            f"of {100 * disc.threshold_contrast:.2g} % contrast"
        )
    if found.noise_measurement is not None:
        sheet = found.noise_measurement.emva
        read = with_reach(sheet.dark_noise_e, NORMAL_95 * sheet.dark_noise_err_e, 2)
        err_e = sheet.saturation_err_e
        full = with_reach(sheet.saturation_e, None if err_e is None else NORMAL_95 * err_e, 0)
        terminal.say(
            f"EMVA 1288: read noise {read} e, saturation {full} e, dynamic range "
            f"{sheet.dynamic_range_text}"
        )
    if found.verdict is not None:
        terminal.print_verdict(found.verdict)
    terminal.say(wrote)


def _show_focus(focus: ThroughFocus) -> None:
    depth = focus.depth_mm
    within = "" if depth is None else f"; {_cell(depth, 4)} mm deep"
    terminal.say(f"best focus at {_cell(focus.best_mm, 4)} mm{within}")
    field = focus.field
    if field is not None:
        terminal.say(
            f"from the centre to the corners: curvature {_cell(field.curvature_mm, 4)} mm, "
            f"astigmatism {_cell(field.astigmatism_mm, 4)} mm; tilt {_cell(field.tilt_mm, 4)} mm "
            "over the picture"
        )


def _cell(known: MeasuredValue | None, digits: int) -> str:
    return "" if known is None else known.estimate.text(digits)
