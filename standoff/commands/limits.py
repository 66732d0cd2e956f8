"""``standoff limits``: how far the camera may be moved before changes are no longer found."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from standoff.terminal import (
    CurveContrast,
    CurveModel,
    CurveNoise,
    CurveObserver,
    CurvesPath,
    Force,
    Json,
    MinDprime,
    check_options,
    checked_zoom,
    curve_choice,
    exactly_one,
    needs,
    print_json,
    print_table,
    quantity,
    refuse_overwriting,
    refuse_suffix,
    say,
)

if TYPE_CHECKING:
    from analysis.pose import PoseLimits


_RULES = (
    exactly_one("geometry", "focal_length_px"),
    needs("focal_length_px", "image_size"),
    needs("image_size", "focal_length_px"),
    needs("at_tilt", "at_zoom"),
)


def limits(
    context: typer.Context,
    *,
    curves: CurvesPath,
    min_dprime: MinDprime,
    geometry: Annotated[Path | None, typer.Option(help="geometry.json of the camera.")] = None,
    focal_length_px: Annotated[
        float | None,
        typer.Option(
            help="Focal length in px, instead of --geometry.", parser=quantity("focal_length_px")
        ),
    ] = None,
    image_size: Annotated[
        str | None, typer.Option(help="Frame size WxH in px, with --focal-length-px.")
    ] = None,
    reference_tilt: Annotated[
        float, typer.Option(min=-75, max=75, help="Tilt of the reference in degrees.")
    ] = 0.0,
    tilt_direction: Annotated[
        float | None,
        typer.Option(
            min=-360,
            max=360,
            help="Direction of the follow-up's tilt, in degrees from +x (the direction of the "
            "reference's tilt) towards +y; the worst direction by default.",
        ),
    ] = None,
    at_zoom: Annotated[
        float | None,
        typer.Option(
            help="Distance ratio at which to print the lowest detectable contrast.",
            callback=checked_zoom,
        ),
    ] = None,
    at_tilt: Annotated[
        float, typer.Option(min=-75, max=75, help="Tilt at --at-zoom in degrees.")
    ] = 0.0,
    plot: Annotated[Path | None, typer.Option(help="Also write a figure (PNG or SVG).")] = None,
    model: CurveModel = None,
    observer: CurveObserver = None,
    noise: CurveNoise = None,
    contrast: CurveContrast = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find the largest distance ratio, tilt and shift that can keep d' above a threshold."""
    check_options(context, _RULES)
    refuse_suffix(plot, "--plot", {".png", ".svg"})
    refuse_overwriting([plot], [curves, geometry], force=force)
    from analysis.reports import plot_limits
    from standoff.library import pose_limits, require_writable, write_figure

    require_writable([plot])
    found = pose_limits(
        curves,
        min_dprime,
        choice=curve_choice(model, observer, noise, contrast),
        geometry=geometry,
        focal_length_px=focal_length_px,
        image_size=None if image_size is None else _size(image_size),
        reference_tilt_deg=reference_tilt,
        direction_deg=tilt_direction,
        at_zoom=at_zoom,
        at_tilt_deg=at_tilt,
    )
    if plot is not None:
        write_figure(plot, plot_limits(found))
    if json:
        print_json(found.to_json())
        return
    where = "in any direction" if tilt_direction is None else f"towards {tilt_direction:g} degrees"
    _print_limits(found.curve.name, min_dprime, found, where)
    if found.contrast_found_dn is not None:
        say(
            f"at zoom {at_zoom:g}, tilt {at_tilt:g} degrees: contrasts from "
            f"{found.contrast_found_dn:.3g} DN are detectable"
        )


def _size(text: str) -> tuple[int, int]:
    size = re.fullmatch(r"(\d{1,6})\s*[x,×]\s*(\d{1,6})", text.strip().lower(), re.ASCII)
    if size is None:
        raise typer.BadParameter(f"--image-size must be WxH in px, such as 780x580, got {text}")
    return int(size[1]), int(size[2])


def _print_limits(name: str, min_dprime: float, found: PoseLimits, where: str) -> None:
    more = " or more (the curve ends there)" if found.is_zoom_beyond_curve else ""
    tilt = "none" if found.tilt_deg is None else f"up to {found.tilt_deg:.1f} degrees"
    say(f"{name}; d' of at least {min_dprime:g}, at best:")
    say(f"straight back: up to {found.zoom:.3f} times the distance{more}")
    say(f"tilt {where} at the same distance: {tilt}")
    print_table(
        f"Distance and tilt {where}",
        ["tilt / degrees", "distance ratio up to"],
        [
            [f"{tilt_deg:g}", "-" if zoom is None else f"{zoom:.3f}"]
            for tilt_deg, zoom in found.zoom_by_tilt
        ],
    )
    print_table(
        "Sideways shift: the sampling stays, the overlap shrinks",
        ["shift / field width", "overlap"],
        [[f"{share:g}", f"{100 * overlap:.0f} %"] for share, overlap in found.overlap_by_shift],
    )
    say("d' is an upper bound: registration, light, gloss, parallax and defocus only lower it")
