"""``standoff capture``: run a capture plan, or resume an interrupted session."""

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
    config = terminal.read_bench(bench, settings)
    preview = library.preview_plan(plan, config, out)
    if dry_run:
        _print_plan(preview, out, json=json)
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
    if json:
        terminal.print_json(found.to_json())
    else:
        terminal.say(
            f"{out}: {found.captured} captured, {found.already_captured} captured earlier, "
            f"{found.skipped} skipped"
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


def _print_plan(preview: PlanPreview, out: Path, *, json: bool) -> None:
    if json:
        terminal.print_json(preview.to_json())
        return
    terminal.print_table(
        f"{len(preview.entries)} captures",
        ["index", "kind", "target", "orientation / deg", "height / mm"],
        [
            [str(e.index), e.kind, e.target, f"{e.orientation_deg:g}", f"{e.height_mm:g}"]
            for e in preview.entries
        ],
    )
    terminal.say(terminal.preview_line(preview.estimate, out))
