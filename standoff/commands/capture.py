"""``standoff capture``: run a capture plan, or resume an interrupted session."""

from __future__ import annotations

import getpass
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

from typer import BadParameter, Option

from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.capture import CaptureProgress, Placement, RunSummary
    from acquisition.plan import PlanEntry, PlanEstimate
    from hil_mocks import SimulatedBench

_PLANNED = ("index", "kind", "target", "orientation_deg", "height_mm", "exposure_us")


def capture(
    *,
    bench: terminal.BenchFile,
    plan: Annotated[Path, Option(help="Capture plan (TOML).")],
    out: Annotated[Path, Option(help="Session folder; an existing session is resumed.")],
    yes: Annotated[
        bool, Option("--yes", help="Do not ask; the simulated bench places its own targets.")
    ] = False,
    placed: Annotated[
        bool, Option("--placed", help="Do not ask; the plan's only target is in place.")
    ] = False,
    answers: Annotated[
        Path | None,
        Option(help="File with one answer per line (- for stdin), from a scripted operator."),
    ] = None,
    retake: Annotated[
        list[int] | None, Option(metavar="I", help="Take capture I again; may be repeated.")
    ] = None,
    dry_run: Annotated[
        bool, Option("--dry-run", help="Show what the plan asks for, and exit.")
    ] = False,
    operator: terminal.OperatorName = None,
    settings: terminal.BenchKeys = None,
    json: terminal.Json = False,
) -> None:
    """Run a capture plan, or resume an interrupted session.

    Press Enter to pause before the next capture. Ctrl-C ends the run; the same command
    resumes it.
    """
    from acquisition.bench import BenchDevices
    from acquisition.capture import RunOperator, run_plan
    from acquisition.plan import estimate_plan, load_plan, plan_entries
    from acquisition.session import MANIFEST_NAME

    config = terminal.read_bench(bench, settings)
    planned = load_plan(plan)
    entries = plan_entries(planned)
    estimate = estimate_plan(planned, entries, config, terminal.frame_shape_of(config))
    if dry_run:
        _print_plan(entries, estimate, out, json=json)
        terminal.note(*terminal.flicker_warnings(planned, entries, config))
        if (out / MANIFEST_NAME).is_file():
            terminal.note(
                f"{out} already holds a session: with the same bench and plan it resumes where it "
                "stopped; with others it is refused"
            )
        return
    comparisons = library.PlannedComparisons.of(planned, plan.parent, out)
    is_simulated = "simulated" in (config.camera.driver, config.stage.driver)
    if placed and not is_simulated and estimate.placements > 1:
        raise BadParameter(
            f"the plan has {estimate.placements} targets or orientations to place in turn, but "
            "--placed is for one only; run it at a terminal, or give --answers",
            param_hint="--placed",
        )
    needs_nobody = (is_simulated and yes) or (placed and config.stage.driver != "manual")
    with ExitStack() as opened:
        person = _operator(opened, answers, estimate.placements, needs_nobody=needs_nobody)
        devices = opened.enter_context(library.open_bench(config, ask=person.ask))
        frame = devices.camera.settings
        shape = (frame.height_px, frame.width_px)
        expected = estimate_plan(planned, entries, config, shape)
        terminal.ERRORS.print(terminal.preview_line(expected, out), markup=False)
        terminal.note(*devices.warnings, *terminal.flicker_warnings(planned, entries, config))
        bar = opened.enter_context(terminal.progress_bar("capturing", len(entries)))
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
    terminal.note(*comparisons.write(terminal.ShownProgress()))
    _print_summary(out, summary, json=json)


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


def _placement(
    simulated: SimulatedBench | None, person: terminal.Operator, *, is_asked: bool
) -> Callable[[PlanEntry], Placement]:
    """Return the callback that has a target placed; it asks the operator only if told to."""
    if simulated is None:
        return person.place if is_asked else lambda _: "ready"
    in_simulation = library.place_in_simulation(simulated)
    if not is_asked:
        return in_simulation

    def ask_then_place(entry: PlanEntry) -> Placement:
        return "skip" if person.place(entry) == "skip" else in_simulation(entry)

    return ask_then_place


def _shown_on(
    bar: terminal.Bar, comparisons: library.PlannedComparisons
) -> Callable[[CaptureProgress], None]:
    def show(done: CaptureProgress) -> None:
        entry, record = done.entry, done.record
        bar.advance_to(
            done.captured,
            f"{entry.target} {entry.orientation_deg:g} deg at {record.height_mm:.3f} mm; frames "
            f"{record.frames_used} good, {record.incomplete_frames} bad; "
            f"{terminal.time_text(done.seconds_left)} left",
        )
        remarks = [f"{finding.problem}: {finding.text}" for finding in done.findings]
        compared = comparisons.pose_sentence(record)
        remarks += [*done.remarks, *([] if compared is None else [compared])]
        terminal.note(*(f"capture {entry.index}: {remark}" for remark in remarks))

    return show


def _print_summary(out: Path, summary: RunSummary, *, json: bool) -> None:
    if json:
        terminal.print_json({"session": str(out), **asdict(summary)})
    else:
        terminal.say(
            f"{out}: {summary.captured} captured, {summary.already_captured} captured earlier, "
            f"{summary.skipped} skipped"
        )


def _print_plan(
    entries: tuple[PlanEntry, ...], estimate: PlanEstimate, out: Path, *, json: bool
) -> None:
    if json:
        captures = [
            {
                **{name: getattr(entry, name) for name in _PLANNED},
                "bracket": None if entry.bracket is None else entry.bracket.model_dump(),
            }
            for entry in entries
        ]
        terminal.print_json(
            {
                "captures": captures,
                "placements": estimate.placements,
                "seconds": round(estimate.seconds, 1),
                "bytes": estimate.bytes_,
            }
        )
        return
    terminal.print_table(
        f"{len(entries)} captures",
        ["index", "kind", "target", "orientation / deg", "height / mm"],
        [
            [str(e.index), e.kind, e.target, f"{e.orientation_deg:g}", f"{e.height_mm:g}"]
            for e in entries
        ],
    )
    terminal.say(terminal.preview_line(estimate, out))
