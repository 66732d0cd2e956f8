"""``standoff capture`` and ``standoff plan-study``: run a capture plan, and what it would tell.

An interrupted session is resumed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

from typer import BadParameter, Option

from acquisition.files import require_folder
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.capture import CaptureProgress, PlanPreview
    from analysis.study import PlanStudy, PredictedQuantity


@terminal.command()
def capture(
    *,
    bench: terminal.BenchFile,
    plan: Path,
    out: Path,
    yes: Annotated[bool, Option("--yes")] = False,
    placed: Annotated[bool, Option("--placed")] = False,
    answers: Path | None = None,
    retake: Annotated[list[int] | None, Option(metavar="I")] = None,
    dry_run: Annotated[bool, Option("--dry-run")] = False,
    operator: terminal.OperatorName = None,
    settings: terminal.BenchKeys = None,
) -> None:
    """Run a capture plan, or resume an interrupted session.

    Press Enter to pause before the next capture. Ctrl-C ends the run; the same command
    resumes it.

    Options
    -------
    plan: Capture plan (TOML).
    out: Session folder; an existing session is resumed.
    yes: Do not ask; the simulated bench places its own targets.
    placed: Do not ask; the plan's only target is in place.
    answers: File with one answer per line (- for stdin), from a scripted operator.
    retake: Take capture I again; may be repeated.
    dry_run: Show what the plan asks for, and exit.
    """
    config = terminal.read_bench(bench, settings)
    preview = library.preview_plan(plan, config, out)
    if dry_run:
        terminal.answer(preview.to_json, lambda: _print_plan(preview, out))
        terminal.note(*preview.notes)
        return
    require_folder(out, is_written=True)
    placements = preview.estimate.placements
    is_simulated = "simulated" in (config.camera.driver, config.stage.driver)
    if placed and not is_simulated and placements > 1:
        raise BadParameter(
            f"the plan has {placements} targets or orientations to place in turn, but "
            "--placed is for one only; run it at a terminal, or give --answers",
            param_hint="--placed",
        )
    is_asked = not (placed or (yes and is_simulated))
    needs_nobody = (is_simulated and yes) or (placed and config.stage.driver != "manual")
    progress = terminal.ShownProgress()
    with ExitStack() as opened:
        person = _operator(opened, answers, placements, needs_nobody=needs_nobody)
        person.hidden = progress.hidden
        found = library.capture_session(
            plan,
            config,
            out,
            operator=operator,
            place=person.place if is_asked else None,
            review=person.review,
            before_capture=person.wait_if_asked,
            ask=person.ask,
            retake=retake or (),
            begun=lambda expected: terminal.ERRORS.print(
                terminal.preview_line(expected, out), markup=False
            ),
            captured=lambda done: progress.describe(_captured_text(done)),
            progress=progress,
        )
    terminal.answer(
        found.to_json,
        lambda: terminal.say(
            f"{out}: {found.captured} captured, {found.already_captured} captured earlier, "
            f"{found.skipped} skipped"
        ),
    )


def _operator(
    opened: ExitStack, answers: Path | None, placements: int, *, needs_nobody: bool
) -> terminal.Operator:
    """Return the operator to ask; refuse if one is needed and none can be asked."""
    if answers is not None:
        if str(answers) == "-":
            return terminal.ScriptedOperator(_lines(sys.stdin), "standard input")
        try:
            # What is no text is no answer; the line that holds it is refused as that.
            file = opened.enter_context(answers.open(encoding="utf-8", errors="replace"))
        except OSError as error:
            raise ApplicationError(f"cannot read {answers}: {error.strerror}") from error
        return terminal.ScriptedOperator(_lines(file), str(answers))
    if sys.stdin is not None and sys.stdin.isatty():
        return terminal.TerminalOperator()
    if needs_nobody:
        return terminal.ScriptedOperator(iter(()), "nobody")
    raise BadParameter(
        f"an operator must place {placements} target(s) or orientation(s), but standard input is "
        "not a terminal: run it at a terminal, script the operator with --answers FILE "
        "(- for stdin), or give --placed if the plan's only target is already in place; "
        "--yes works on the simulated bench only"
    )


def _lines(file: TextIO) -> Iterator[str]:
    return iter(partial(file.readline, terminal.LONGEST_ANSWER + 1), "")


def _captured_text(done: CaptureProgress) -> str:
    entry, record = done.entry, done.record
    return (
        f"{entry.target} {entry.orientation_deg:g} deg at {record.height_mm:.3f} mm; frames "
        f"{record.frames_used} good, {record.incomplete_frames} bad; "
        f"{terminal.time_text(done.seconds_left)} left"
    )


def _print_plan(preview: PlanPreview, out: Path) -> None:
    terminal.print_items(
        f"{len(preview.entries)} captures",
        preview.entries,
        {
            "index": lambda entry: str(entry.index),
            "kind": lambda entry: entry.kind,
            "target": lambda entry: entry.target,
            "orientation / deg": lambda entry: f"{entry.orientation_deg:g}",
            "height / mm": lambda entry: f"{entry.height_mm:g}",
        },
    )
    terminal.say(terminal.preview_line(preview.estimate, out))


_LEVELS = terminal.ListedNumbers(option="--levels")


@terminal.command()
def plan_study(
    *,
    bench: terminal.BenchFile,
    plan: Path,
    psf: Path,
    want: Annotated[list[str] | None, Option(metavar="NAME=VALUE")] = None,
    photographs: list[Path] | None = None,
    photograph_count: Annotated[int | None, Option(min=1)] = None,
    focus_scatter_px2: Annotated[float | None, Option("--focus-scatter", min=0)] = None,
    height_scatter_mm: Annotated[float | None, Option("--height-scatter", min=0)] = None,
    noise: Path | None = None,
    geometry: Path | None = None,
    edges_per_capture: Annotated[int | None, Option(min=1)] = None,
    edge_length_px: Annotated[float | None, Option("--edge-length", min=1)] = None,
    levels: Annotated[str | None, Option(metavar="DARK,BRIGHT")] = None,
    board: terminal.Board,
    scene_noise_dn: Annotated[float | None, Option("--scene-noise")] = None,
    contrast_dn: Annotated[float | None, Option("--contrast")] = None,
    signal_sigma_px: Annotated[float, Option("--signal-sigma", min=0.3)] = 2.0,
    min_d_prime: terminal.MinDprime = 2.0,
    out: Annotated[Path | None, terminal.Result(".json")] = None,
    settings: terminal.BenchKeys = None,
) -> None:
    """Predict how precisely a planned session will measure, and what would improve it.

    Options
    -------
    plan: Capture plan (TOML).
    psf: psf.json, as known today.
    want: Precision wanted, as half a 95 % interval: sigma=0.5%, transfer=1%, pupil=0.5mm, dprime=5%
        or tilt=0.3deg; may be repeated.
    photographs: Photograph of the scene; may be repeated. Built-in pictures by default.
    photograph_count: Planned number of photographs of the scene; by default, the number given.
    focus_scatter_px2: Scatter of the PSF variance between captures, in px^2; by default that of
        psf.json.
    height_scatter_mm: Scatter, in mm, of the heights read back about the true heights.
    noise: noise.json of the camera.
    geometry: geometry.json of an earlier session.
    edges_per_capture: Number of edges in a capture; as in psf.json by default.
    edge_length_px: Length of an edge in px; as in psf.json by default.
    levels: Dark and bright level of the edges in DN.
    scene_noise_dn: Noise of a pixel of the photographs in DN.
    contrast_dn: Peak of the change in DN; 5 % of the mean level by default.
    signal_sigma_px: Sigma of the Gaussian change in px.
    out: Also write study.json.
    """
    from acquisition.bench import parse_overrides

    terminal.read_bench(bench, settings)  # a bad override is wrong usage
    how = terminal.keywords_of(
        library.plan_study,
        want=want or (),
        photographs=photographs or (),
        levels_dn=_two_levels(levels),
        settings=parse_overrides(settings or []),
    )
    found = library.plan_study(plan, bench, psf, **how)
    if out is not None:
        library.write_study(out, found)
    terminal.answer(found, lambda: _print_study(found, out))


def _two_levels(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    found = terminal.number_list(text, _LEVELS)
    if len(found) != 2 or not found[0] < found[1]:
        raise BadParameter(f"expected DARK,BRIGHT, got {text}", param_hint="--levels")
    return found[0], found[1]


def _print_study(found: PlanStudy, out: Path | None) -> None:
    from analysis.study import NAMES

    terminal.print_table(
        f"Expected precision: {found.captures} captures of {found.frames_per_capture} frames, "
        f"{found.edges} edges, {found.photographs} photographs of the scene",
        ["", "value", "± at 95 %", "relative", "mostly by"],
        [[NAMES[one.quantity], *_cells(one)] for one in found.predicted],
        ends_in_words=True,
    )
    terminal.say(*(one.sentence for one in found.wants))
    terminal.say(*(f"assumed: {text}" for text in found.assumptions))
    terminal.say(f"next: {found.next_step}")
    if out is not None:
        terminal.say(f"wrote {out}")


def _cells(one: PredictedQuantity) -> list[str]:
    value = "unknown" if one.value is None else f"{one.value:.5g}"
    if one.half_width_95 is None:
        return [value, "", "", one.undetermined or ""]
    relative = f"{100 * one.half_width_95 / abs(one.value):.2g} %" if one.value else ""
    mostly = ", ".join(
        f"{part.source} ({100 * part.share:.0f} %)" for part in one.budget if part.share >= 0.1
    )
    return [value, f"{one.half_width_95:.2g}", relative, mostly]
