"""``standoff capture`` and ``standoff verify``: make a capture session, check its files."""

import getpass
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from acquisition.plan import PlanEntry, load_plan, plan_entries
from acquisition.runner import CaptureProgress, Placement, run_plan
from acquisition.session import verify as verify_session
from hil_mocks import SimulatedBench
from standoff.devices import open_bench, place_in_simulation
from standoff.errors import ApplicationError
from standoff.options import BenchFile, BenchKeys, Json, read_bench
from standoff.output import ERRORS, note, print_json, print_table, progress_bar, say

__all__ = ["capture", "verify"]


def capture(
    *,
    bench: BenchFile,
    plan: Annotated[Path, typer.Option(help="Capture plan (TOML).")],
    out: Annotated[Path, typer.Option(help="Session directory, new or to be resumed.")],
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask; for the simulated bench.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what the plan asks for, and stop.")
    ] = False,
    operator: Annotated[
        str | None, typer.Option(help="Who captures; the login name by default.")
    ] = None,
    settings: BenchKeys = None,
    json: Json = False,
) -> None:
    """Run a capture plan, or go on with one that was interrupted."""
    config = read_bench(bench, settings)
    planned = load_plan(plan)
    entries = plan_entries(planned)
    if dry_run:
        _print_plan(entries, json)
        return
    with open_bench(config) as devices, progress_bar("capturing", len(entries)) as bar:

        def show(done: CaptureProgress) -> None:
            entry = done.entry
            bar.advance_to(
                done.captured,
                f"{entry.target} {entry.orientation_deg:g} deg at {entry.height_mm:g} mm",
            )

        for warning in devices.warnings:
            note(warning)
        place = _placement(devices.simulated, yes)
        summary = run_plan(
            out,
            plan=planned,
            bench=config,
            camera=devices.camera,
            stage=devices.stage,
            operator=operator or getpass.getuser(),
            place=place,
            progress=show,
            clock=devices.clock,
        )
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
        f"{out}: {summary.captured} captured, {summary.already_captured} were there already, "
        f"{summary.skipped} skipped"
    )


def verify(
    directory: Annotated[Path, typer.Argument(help="Session directory.", show_default=False)],
    json: Json = False,
) -> None:
    """Check every file of a session against its journal."""
    report = verify_session(directory)
    if json:
        print_json(
            {
                "session": str(directory),
                "ok": report.is_ok,
                "files": [
                    {"file": c.file, "state": c.state, "superseded": c.is_superseded}
                    for c in report.files
                ],
                "remarks": list(report.remarks),
            }
        )
    else:
        for remark in report.remarks:
            note(remark)
        for check in report.files:
            if check.state != "ok":
                say(f"{check.state:12} {check.file}")
        good = sum(check.state == "ok" for check in report.files)
        say(f"{good} of {len(report.files)} files are as journaled")
    if not report.is_ok:
        raise ApplicationError(
            f"{directory}: files are missing or changed; restore them from a copy, "
            "or run the capture command again to retake them"
        )


def _place_by_hand(entry: PlanEntry) -> Placement:
    """Ask the operator to lay the target under the camera."""
    ERRORS.print(f"Place {entry.kind} {entry.target!r} at {entry.orientation_deg:g} degrees.")
    answer = typer.prompt("Enter to capture, s to skip", default="", show_default=False, err=True)
    return "skip" if answer.strip().lower() == "s" else "ready"


def _placement(bench: SimulatedBench | None, yes: bool) -> Callable[[PlanEntry], Placement]:
    if bench is None:
        return _place_by_hand
    in_simulation = place_in_simulation(bench)
    if yes:
        return in_simulation

    def ask_then_place(entry: PlanEntry) -> Placement:
        return "skip" if _place_by_hand(entry) == "skip" else in_simulation(entry)

    return ask_then_place


def _print_plan(entries: tuple[PlanEntry, ...], json: bool) -> None:
    if json:
        print_json(
            [
                {
                    "index": e.index,
                    "kind": e.kind,
                    "target": e.target,
                    "orientation_deg": e.orientation_deg,
                    "height_mm": e.height_mm,
                }
                for e in entries
            ]
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
