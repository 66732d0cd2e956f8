"""``standoff compare``: has the PSF changed? Two calibrations, or all of them over time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from standoff.terminal import (
    Force,
    Json,
    ShownProgress,
    check_options,
    needs,
    note_once,
    print_json,
    print_table,
    refuse_overwriting,
    refuse_suffix,
    say,
)

_RULES = (needs("report", "history"),)


def compare(
    context: typer.Context,
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Two psf.json files; with --history, any number of files or folders.",
            show_default=False,
        ),
    ],
    *,
    history: Annotated[
        bool, typer.Option("--history", help="Show all calibrations by camera and over time.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="Also write a report on the history (HTML or PDF).")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Test whether the PSF has changed between two calibrations, or show it over time."""
    check_options(context, _RULES)
    refuse_suffix(report, "--report", {".html", ".htm", ".pdf"})
    refuse_overwriting([report], files, force=force)
    if history:
        _show_history(files, report, json)
        return
    if len(files) != 2:
        raise typer.BadParameter(f"give two psf.json files, got {len(files)}; or use --history")
    from calibration.sharpness import NORMAL_95, with_reach
    from standoff.library import compare_psfs

    change = compare_psfs(*files)
    note_once(change.notes)
    if json:
        print_json(change.to_json())
        return
    print_table(
        "PSF, ± at 95 %",
        ["", "first", "second", "difference", "z", "p", "p (Holm)"],
        [
            [
                one.name,
                with_reach(one.first, NORMAL_95 * one.first_err, 4),
                with_reach(one.second, NORMAL_95 * one.second_err, 4),
                with_reach(one.difference, NORMAL_95 * one.difference_err, 4),
                f"{one.z:+.2f}",
                f"{one.p_value:.2g}",
                f"{one.p_value_holm:.2g}",
            ]
            for one in change.parameters
        ],
    )
    say(change.verdict)


def _show_history(files: list[Path], report: Path | None, json: bool) -> None:
    from standoff.library import psf_history, require_writable

    require_writable([report])
    found = psf_history(files, progress=ShownProgress())
    if report is not None:
        found.write_report(report)
    if json:
        print_json(found.to_json())
        return
    for section in found.sections:
        table = section.tables[0]
        print_table(
            f"{section.title}, ± at 95 %",
            list(table.columns),
            [list(row) for row in table.rows],
            ends_in_words=table.ends_in_words,
        )
    if report is not None:
        say(f"wrote {report}")
