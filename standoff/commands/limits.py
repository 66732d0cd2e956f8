"""``standoff limits``: how far the camera may be moved before changes are no longer found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Context, Option

from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.pose import PoseLimits

_RULES = (
    terminal.exactly_one("geometry", "focal_length_px"),
    terminal.needs("focal_length_px", "image_size"),
    terminal.needs("image_size", "focal_length_px"),
    terminal.needs("at_tilt", "at_zoom"),
)


def limits(
    context: Context,
    *,
    curves: terminal.CurvesPath,
    min_dprime: terminal.MinDprime,
    geometry: Annotated[Path | None, Option(help="geometry.json of the camera.")] = None,
    focal_length_px: Annotated[
        float | None,
        Option(
            help="Focal length in px, instead of --geometry.",
            parser=terminal.quantity("focal_length_px"),
        ),
    ] = None,
    image_size: Annotated[
        str | None, Option(help="Frame size WxH in px, with --focal-length-px.")
    ] = None,
    reference_tilt: Annotated[
        float, Option(min=-75, max=75, help="Tilt of the reference in degrees.")
    ] = 0.0,
    tilt_direction: Annotated[
        float | None,
        Option(
            min=-360,
            max=360,
            help="Direction of the follow-up's tilt, in degrees from +x (the direction of the "
            "reference's tilt) towards +y; the worst direction by default.",
        ),
    ] = None,
    at_zoom: Annotated[
        float | None,
        Option(
            help="Distance ratio at which to print the lowest detectable contrast.",
            callback=terminal.checked_zoom,
        ),
    ] = None,
    at_tilt: Annotated[float, Option(min=-75, max=75, help="Tilt at --at-zoom in degrees.")] = 0.0,
    plot: Annotated[Path | None, Option(help="Also write a figure (PNG or SVG).")] = None,
    focus_scatter: terminal.FocusScatter = None,
    model: terminal.CurveModel = None,
    observer: terminal.CurveObserver = None,
    noise: terminal.CurveNoise = None,
    contrast: terminal.CurveContrast = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Find the largest distance ratio, tilt and shift that can keep d' above a threshold."""
    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(plot, "--plot", {".png", ".svg"})
    terminal.refuse_overwriting([plot], [curves, geometry], force=force)
    library.require_writable([plot])
    found = library.pose_limits(
        curves,
        min_dprime,
        choice=terminal.curve_choice(model, observer, noise, contrast),
        geometry=geometry,
        focal_length_px=focal_length_px,
        image_size=None if image_size is None else terminal.parsed_size(image_size),
        reference_tilt_deg=reference_tilt,
        direction_deg=tilt_direction,
        at_zoom=at_zoom,
        at_tilt_deg=at_tilt,
        focus_scatter_px2=focus_scatter,
    )
    if plot is not None:
        found.write_plot(plot)
    if json:
        terminal.print_json(found.to_json())
        return
    where = "in any direction" if tilt_direction is None else f"towards {tilt_direction:g} degrees"
    _print_limits(found, min_dprime, where)
    if found.contrast_found_dn is not None:
        terminal.say(
            f"at zoom {at_zoom:g}, tilt {at_tilt:g} degrees: contrasts from "
            f"{found.contrast_found_dn:.3g} DN are detectable"
        )


def _interval(ends: tuple[float | None, float | None], digits: int) -> str:
    """The interval of a limit; its ends may lie beyond what can be said."""
    low, high = ends
    if low is None and high is None:
        return ""
    least = "none" if low is None else f"{low:.{digits}f}"
    most = "the curve's end" if high is None else f"{high:.{digits}f}"
    return f" (95 %: {least} to {most})"


def _print_limits(found: PoseLimits, min_dprime: float, where: str) -> None:
    more = " or more (the curve ends there)" if found.is_zoom_beyond_curve else ""
    tilt = "none" if found.tilt_deg is None else f"up to {found.tilt_deg:.1f} degrees"
    terminal.say(
        f"{found.curve.name}; d' of at least {min_dprime:g}, at best:",
        f"straight back: up to {found.zoom:.3f} times the distance{more}"
        f"{_interval(found.zoom_interval_95, 3)}",
        f"tilt {where} at the same distance: {tilt}{_interval(found.tilt_interval_95_deg, 1)}",
    )
    terminal.print_table(
        f"Distance and tilt {where}",
        ["tilt / degrees", "distance ratio up to"],
        [
            [f"{tilt_deg:g}", "-" if zoom is None else f"{zoom:.3f}"]
            for tilt_deg, zoom in found.zoom_by_tilt
        ],
    )
    terminal.print_table(
        "Sideways shift: the sampling stays, the overlap shrinks",
        ["shift / field width", "overlap"],
        [[f"{share:g}", f"{100 * overlap:.0f} %"] for share, overlap in found.overlap_by_shift],
    )
    terminal.say(terminal.UPPER_BOUND)
