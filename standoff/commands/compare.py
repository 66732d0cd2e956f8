"""``standoff compare``: has the PSF changed? Two calibrations, or all of them over time."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.errors import CalibrationError
from standoff.errors import ApplicationError
from standoff.terminal import (
    Force,
    Json,
    check_options,
    needs,
    note,
    print_json,
    print_table,
    refuse_overwriting,
    refuse_suffix,
    say,
)

if TYPE_CHECKING:
    from calibration.psf import PsfCalibration


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
    from calibration.files import read_psf
    from calibration.psf import compare_psfs
    from calibration.sharpness import NORMAL_95, with_reach

    first, second = (read_psf(path) for path in files)
    try:
        change = compare_psfs(first, second)
    except CalibrationError as error:
        raise CalibrationError(f"{files[0]} and {files[1]}: {error}") from error
    for remark in change.remarks:
        note(remark)
    if json:
        print_json(
            {
                "first": str(files[0]),
                "second": str(files[1]),
                "is_changed": bool(change.changed),
                "verdict": change.verdict,
                "remarks": list(change.remarks),
                "shared_inputs": list(change.shared_inputs),
                "parameters": [
                    {
                        **asdict(one),
                        "difference": one.difference,
                        "z": one.z,
                        "p_value": one.p_value,
                        "is_changed": one.is_changed,
                    }
                    for one in change.parameters
                ],
            }
        )
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
    from analysis.reports import (
        Report,
        history_document,
        history_sections,
        ordered_history,
        render_report,
        versions,
    )
    from standoff.workflows import provenance_of, require_writable, write_page

    require_writable([report])
    calibrations = _calibrations(files)
    found = ordered_history(calibrations)
    provenance = provenance_of(None, *(Path(name) for name, _ in calibrations))
    if report is not None:
        page = render_report(
            Report(
                title="PSF history",
                subtitle=f"Calibrations: {sum(map(len, found.values()))}; cameras: {len(found)}",
                verdicts=(),
                sections=history_sections(found),
                provenance=versions(),
                origin=provenance,
            )
        )
        write_page(report, page)
    if json:
        print_json({**history_document(found), "provenance": provenance.model_dump(mode="json")})
        return
    for section in history_sections(found):
        table = section.tables[0]
        print_table(
            f"{section.title}, ± at 95 %",
            list(table.columns),
            [list(row) for row in table.rows],
            ends_in_words=table.ends_in_words,
        )
    if report is not None:
        say(f"wrote {report}")


def _calibrations(paths: list[Path]) -> list[tuple[str, PsfCalibration]]:
    """Read files, and every psf.json below folders; what cannot be read below one is noted."""
    from calibration.files import read_psf

    found = []
    for path in paths:
        if not path.is_dir():
            found.append((str(path), read_psf(path)))
            continue
        for file in sorted(path.rglob("*psf*.json")):
            try:
                found.append((str(file), read_psf(file)))
            except CalibrationError as error:
                note(f"left out: {error}")
    if not found:
        raise ApplicationError(f"no psf.json in {', '.join(map(str, paths))}")
    return found
