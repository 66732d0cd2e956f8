"""``standoff plan-study``: what a planned capture session will know, and what it would take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from calibration.choices import DEFAULT_BOARD_TEXT
from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.study import PlanStudy, PredictedQuantity

_LEVELS = terminal.ListedNumbers(option="--levels")


def plan_study(
    *,
    bench: terminal.BenchFile,
    plan: Annotated[Path, Option(help="Capture plan (TOML).")],
    psf: Annotated[Path, Option(help="psf.json, as known today.")],
    want: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=VALUE",
            help="What is wanted, as half a 95 % interval: sigma=0.5%, transfer=1%, pupil=0.5mm, "
            "dprime=5% or tilt=0.3deg; may be repeated.",
        ),
    ] = None,
    photographs: Annotated[
        list[Path] | None,
        Option(help="Photograph of the scene; may be repeated. Built-in pictures by default."),
    ] = None,
    photograph_count: Annotated[
        int | None,
        Option(min=1, help="Photographs of the scene that are planned; those given by default."),
    ] = None,
    focus_scatter: Annotated[
        float | None,
        Option(
            min=0, help="Scatter of the PSF's variance between captures in px^2; psf.json's if any."
        ),
    ] = None,
    height_scatter: Annotated[
        float | None, Option(min=0, help="Scatter of heights read back about the true ones in mm.")
    ] = None,
    noise: Annotated[Path | None, Option(help="noise.json of the camera.")] = None,
    geometry: Annotated[Path | None, Option(help="geometry.json of an earlier session.")] = None,
    edges_per_capture: Annotated[
        int | None, Option(min=1, help="Edges that a capture shows; as in psf.json by default.")
    ] = None,
    edge_length: Annotated[
        float | None, Option(min=1, help="Length of an edge in px; as in psf.json by default.")
    ] = None,
    levels: Annotated[
        str | None, Option(metavar="DARK,BRIGHT", help="Levels of the edges in DN.")
    ] = None,
    board: Annotated[
        str, Option(metavar="COLSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]", help="The ChArUco board.")
    ] = DEFAULT_BOARD_TEXT,
    scene_noise: Annotated[
        float | None, Option(help="Noise of a pixel of the photographs in DN.")
    ] = None,
    contrast: Annotated[
        float | None, Option(help="Peak of the change in DN; 5 % of the mean level by default.")
    ] = None,
    signal_sigma: Annotated[
        float, Option(min=0.3, help="Sigma of the Gaussian change in px.")
    ] = 2.0,
    min_dprime: terminal.MinDprime = 2.0,
    out: Annotated[Path | None, Option(help="Also write study.json.")] = None,
    settings: terminal.BenchKeys = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Predict what a planned session will know, and what it would take to know more."""
    from acquisition.bench import parse_overrides

    terminal.refuse_suffix(out, "--out", {".json"})
    inputs = [bench, plan, psf, noise, geometry, *(photographs or ())]
    terminal.refuse_overwriting([out], inputs, force=force)
    library.require_writable([out])
    terminal.read_bench(bench, settings)  # a bad override is wrong usage
    found = library.plan_study(
        plan,
        bench,
        psf,
        want=want or (),
        photographs=photographs or (),
        photograph_count=photograph_count,
        focus_scatter_px2=focus_scatter,
        height_scatter_mm=height_scatter,
        noise=noise,
        geometry=geometry,
        edges_per_capture=edges_per_capture,
        edge_length_px=edge_length,
        levels_dn=_two_levels(levels),
        board=terminal.charuco_board(board),
        scene_noise_dn=scene_noise,
        contrast_dn=contrast,
        signal_sigma_px=signal_sigma,
        min_d_prime=min_dprime,
        settings=parse_overrides(settings or []),
        progress=terminal.ShownProgress(),
    )
    if out is not None:
        library.write_study(out, found)
    if json:
        terminal.print_json(found)
        return
    _print(found)
    if out is not None:
        terminal.say(f"wrote {out}")


def _two_levels(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    found = terminal.number_list(text, _LEVELS)
    if len(found) != 2 or not found[0] < found[1]:
        raise BadParameter(f"expected DARK,BRIGHT, got {text}", param_hint="--levels")
    return found[0], found[1]


def _print(found: PlanStudy) -> None:
    from analysis.study import NAMES

    terminal.print_table(
        f"What the plan will know: {found.captures} captures of {found.frames_per_capture} frames, "
        f"{found.edges} edges, {found.photographs} photographs of the scene",
        ["", "value", "± at 95 %", "relative", "mostly by"],
        [[NAMES[one.quantity], *_cells(one)] for one in found.predicted],
        ends_in_words=True,
    )
    terminal.say(*(one.sentence for one in found.wants))
    terminal.say(*(f"taken for granted: {text}" for text in found.assumptions))
    terminal.say(f"next: {found.next_step}")


def _cells(one: PredictedQuantity) -> list[str]:
    value = "unknown" if one.value is None else f"{one.value:.5g}"
    if one.half_width_95 is None:
        return [value, "", "", one.undetermined or ""]
    relative = f"{100 * one.half_width_95 / abs(one.value):.2g} %" if one.value else ""
    mostly = ", ".join(
        f"{part.source} ({100 * part.share:.0f} %)" for part in one.budget if part.share >= 0.1
    )
    return [value, f"{one.half_width_95:.2g}", relative, mostly]
