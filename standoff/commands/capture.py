"""``standoff capture``: run a capture plan, or resume an interrupted session."""

from __future__ import annotations

import getpass
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from standoff.errors import ApplicationError
from standoff.terminal import (
    ERRORS,
    Bar,
    BenchFile,
    BenchKeys,
    Json,
    ShownProgress,
    note,
    print_json,
    print_table,
    progress_bar,
    read_bench,
    say,
)

if TYPE_CHECKING:
    from acquisition.capture import CaptureProgress, Placement, RunSummary
    from acquisition.plan import PlanEntry, PlanEstimate
    from hil_mocks import SimulatedBench
    from standoff.library import PlannedComparisons
    from standoff.terminal import Operator


def capture(
    *,
    bench: BenchFile,
    plan: Annotated[Path, typer.Option(help="Capture plan (TOML).")],
    out: Annotated[Path, typer.Option(help="Session folder; an existing session is resumed.")],
    yes: Annotated[
        bool,
        typer.Option("--yes", help="Do not ask; the simulated bench places its own targets."),
    ] = False,
    placed: Annotated[
        bool,
        typer.Option("--placed", help="Do not ask; the plan's only target is in place."),
    ] = False,
    answers: Annotated[
        Path | None,
        typer.Option(help="File with one answer per line (- for stdin), from a scripted operator."),
    ] = None,
    retake: Annotated[
        list[int] | None,
        typer.Option(metavar="I", help="Take capture I again; may be repeated."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what the plan asks for, and exit.")
    ] = False,
    operator: Annotated[
        str | None, typer.Option(help="Name of the operator; the login name by default.")
    ] = None,
    settings: BenchKeys = None,
    json: Json = False,
) -> None:
    """Run a capture plan, or resume an interrupted session.

    Press Enter to pause before the next capture. Ctrl-C ends the run; the same command
    resumes it.
    """
    from acquisition.bench import BenchDevices
    from acquisition.capture import RunOperator, run_plan
    from acquisition.plan import estimate_plan, load_plan, plan_entries
    from acquisition.session import MANIFEST_NAME
    from standoff.library import PlannedComparisons, open_bench
    from standoff.terminal import flicker_warnings, frame_shape_of, preview_lines

    config = read_bench(bench, settings)
    planned = load_plan(plan)
    entries = plan_entries(planned)
    estimate = estimate_plan(planned, entries, config, frame_shape_of(config))
    if dry_run:
        _print_plan(entries, estimate, out, json=json)
        for warning in flicker_warnings(planned, entries, config):
            note(warning)
        if (out / MANIFEST_NAME).is_file():
            note(
                f"{out} already holds a session: with the same bench and plan it resumes where it "
                "stopped; with others it is refused"
            )
        return
    comparisons = PlannedComparisons.of(planned, plan.parent, out)
    is_simulated = "simulated" in (config.camera.driver, config.stage.driver)
    _refuse_placed(placed, is_simulated, estimate.placements)
    needs_nobody = (is_simulated and yes) or (placed and config.stage.driver != "manual")
    with ExitStack() as opened:
        person = _operator(opened, answers, estimate.placements, needs_nobody=needs_nobody)
        devices = opened.enter_context(open_bench(config, ask=person.ask))
        frame = devices.camera.settings
        shape = (frame.height_px, frame.width_px)
        for line in preview_lines(estimate_plan(planned, entries, config, shape), out):
            ERRORS.print(line, markup=False)
        for warning in (*devices.warnings, *flicker_warnings(planned, entries, config)):
            note(warning)
        bar = opened.enter_context(progress_bar("capturing", len(entries)))
        person.hidden = bar.hidden
        summary = run_plan(
            out,
            planned,
            BenchDevices(
                config=config,
                camera=devices.camera,
                stage=devices.stage,
                clock=devices.clock,
                sleep=devices.sleep,
            ),
            RunOperator(
                name=operator or getpass.getuser(),
                place=_placement(
                    devices.simulated, person, is_asked=not (placed or (yes and is_simulated))
                ),
                progress=_shown_on(bar, comparisons),
                review=person.review,
                before_capture=person.wait_if_asked,
            ),
            retake=retake or (),
        )
    for sentence in comparisons.write(ShownProgress()):
        note(sentence)
    _print_summary(out, summary, json=json)


def _refuse_placed(placed: bool, is_simulated: bool, placements: int) -> None:
    """Refuse ``--placed`` if the plan has several targets to place."""
    if placed and not is_simulated and placements > 1:
        raise typer.BadParameter(
            f"the plan has {placements} targets or orientations to place in turn, but --placed is "
            "for one only; run it at a terminal, or give --answers",
            param_hint="--placed",
        )


def _operator(
    opened: ExitStack, answers: Path | None, placements: int, *, needs_nobody: bool
) -> Operator:
    """Return the operator to ask; refuse if one is needed and none can be asked."""
    from standoff.terminal import LONGEST_ANSWER, ScriptedOperator, TerminalOperator

    if answers is not None:
        if str(answers) == "-":
            return ScriptedOperator(_lines_of_stdin(), "standard input")
        try:
            # What is no text is no answer; the line that holds it is refused as that.
            file = opened.enter_context(answers.open(encoding="utf-8", errors="replace"))
        except OSError as error:
            raise ApplicationError(f"cannot read {answers}: {error.strerror}") from error
        lines = iter(partial(file.readline, LONGEST_ANSWER + 1), "")
        return ScriptedOperator(lines, str(answers))
    if sys.stdin is not None and sys.stdin.isatty():
        return TerminalOperator()
    if needs_nobody:
        return ScriptedOperator(iter(()), "nobody")
    raise typer.BadParameter(
        f"an operator must place {placements} target(s) or orientation(s), but standard input is "
        "not a terminal: run it at a terminal, script the operator with --answers FILE "
        "(- for stdin), or give --placed if the plan's only target is already in place; "
        "--yes works on the simulated bench only"
    )


def _lines_of_stdin() -> Iterator[str]:
    from standoff.terminal import LONGEST_ANSWER

    return iter(partial(sys.stdin.readline, LONGEST_ANSWER + 1), "")


def _placement(
    simulated: SimulatedBench | None, person: Operator, *, is_asked: bool
) -> Callable[[PlanEntry], Placement]:
    """Return the callback that has a target placed; it asks the operator only if told to."""
    from standoff.library import place_in_simulation

    if simulated is None:
        return person.place if is_asked else lambda _: "ready"
    in_simulation = place_in_simulation(simulated)
    if not is_asked:
        return in_simulation

    def ask_then_place(entry: PlanEntry) -> Placement:
        return "skip" if person.place(entry) == "skip" else in_simulation(entry)

    return ask_then_place


def _shown_on(bar: Bar, comparisons: PlannedComparisons) -> Callable[[CaptureProgress], None]:
    from standoff.terminal import time_text

    def show(done: CaptureProgress) -> None:
        entry, record = done.entry, done.record
        bar.advance_to(
            done.captured,
            f"{entry.target} {entry.orientation_deg:g} deg at {record.height_mm:.3f} mm; frames "
            f"{record.frames_used} good, {record.incomplete_frames} bad; "
            f"{time_text(done.seconds_left)} left",
        )
        for finding in done.findings:
            note(f"capture {entry.index}: {finding.problem}: {finding.text}")
        for remark in done.remarks:
            note(f"capture {entry.index}: {remark}")
        compared = comparisons.pose_sentence(record)
        if compared is not None:
            note(f"capture {entry.index}: {compared}")

    return show


def _print_summary(out: Path, summary: RunSummary, *, json: bool) -> None:
    if json:
        print_json(
            {
                "session": str(out),
                "captured": summary.captured,
                "already_captured": summary.already_captured,
                "skipped": summary.skipped,
            }
        )
        return
    say(
        f"{out}: {summary.captured} captured, {summary.already_captured} captured earlier, "
        f"{summary.skipped} skipped"
    )


def _print_plan(
    entries: tuple[PlanEntry, ...], estimate: PlanEstimate, out: Path, *, json: bool
) -> None:
    from standoff.terminal import preview_lines

    if json:
        print_json(
            {
                "captures": [
                    {
                        "index": e.index,
                        "kind": e.kind,
                        "target": e.target,
                        "orientation_deg": e.orientation_deg,
                        "height_mm": e.height_mm,
                        "exposure_us": e.exposure_us,
                        "bracket": None if e.bracket is None else e.bracket.model_dump(),
                    }
                    for e in entries
                ],
                "placements": estimate.placements,
                "seconds": round(estimate.seconds, 1),
                "bytes": estimate.bytes_,
            }
        )
        return
    print_table(
        f"{len(entries)} captures",
        ["index", "kind", "target", "orientation / deg", "height / mm"],
        [
            [str(e.index), e.kind, e.target, f"{e.orientation_deg:g}", f"{e.height_mm:g}"]
            for e in entries
        ],
    )
    for line in preview_lines(estimate, out):
        say(line)
