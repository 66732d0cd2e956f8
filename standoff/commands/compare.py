"""``standoff compare``: has the PSF changed? Two calibrations, or all of them over time."""

from pathlib import Path
from typing import Annotated

from typer import Argument, BadParameter, Context, Option

from standoff import library, terminal

_RULES = (terminal.needs("report", "history"),)


def compare(
    context: Context,
    files: Annotated[
        list[Path],
        Argument(
            help="Two psf.json files; with --history, any number of files or folders.",
            show_default=False,
        ),
    ],
    *,
    history: Annotated[
        bool, Option("--history", help="Show all calibrations by camera and over time.")
    ] = False,
    report: Annotated[
        Path | None, Option(help="Also write a report on the history (HTML or PDF).")
    ] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Test whether the PSF has changed between two calibrations, or show it over time."""
    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(report, "--report", terminal.REPORTS)
    terminal.refuse_overwriting([report], files, force=force)
    if history:
        _show_history(files, report, json)
        return
    if len(files) != 2:
        raise BadParameter(f"give two psf.json files, got {len(files)}; or use --history")
    from calibration.sharpness import NORMAL_95, with_reach

    change = library.compare_psfs(*files)
    terminal.note_once(change.notes)
    if json:
        terminal.print_json(change.to_json())
        return
    terminal.print_table(
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
    terminal.say(change.verdict)


def _show_history(files: list[Path], report: Path | None, json: bool) -> None:
    library.require_writable([report])
    found = library.psf_history(files, progress=terminal.ShownProgress())
    if report is not None:
        found.write_report(report)
    if json:
        terminal.print_json(found.to_json())
        return
    for section in found.sections:
        table = section.tables[0]
        terminal.print_table(
            f"{section.title}, ± at 95 %",
            table.columns,
            table.rows,
            ends_in_words=table.ends_in_words,
        )
        for sentence in section.text[1:]:
            terminal.say(sentence)
    if report is not None:
        terminal.say(f"wrote {report}")
