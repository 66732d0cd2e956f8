"""Sections on comparisons and poses whose results are stored, for the report of a session."""

from base64 import b64encode

from markupsafe import Markup

from analysis.changes import (
    ChangeSummary,
    describe_focus,
    describe_limit,
    describe_prediction,
)
from analysis.pose import PoseSummary
from analysis.reports.changes.sections import comparison_sentence, count_text, list_table
from analysis.reports.page import ReportFigure, ReportSection, ReportTable

_LISTED = 20
_FIGURE_WIDTH_IN = 7.0


def stored_changes_section(
    name: str, summary: ChangeSummary, figure_png: bytes | None
) -> ReportSection:
    """Show a stored changes.json, and its figure if it is there."""
    text = [
        f"{summary.followup} against {summary.reference}: {count_text(len(summary.changes))}. "
        f"{comparison_sentence(summary)}."
    ]
    said = (describe_limit(summary), describe_prediction(summary), describe_focus(summary))
    text += [f"{sentence[0].upper()}{sentence[1:]}." for sentence in said if sentence is not None]
    text += [f"Warning: {warning}." for warning in summary.warnings]
    if len(summary.changes) > _LISTED:
        text.append(f"The first {_LISTED} changes are listed.")
    figures: tuple[ReportFigure, ...] = ()
    if figure_png is not None:
        encoded = b64encode(figure_png).decode("ascii")
        image = Markup(f'<img alt="" src="data:image/png;base64,{encoded}">')  # noqa: S704 - base64
        caption = "The follow-up with its changes outlined, both differences, and the significance."
        figures = (ReportFigure(markup=image, caption=caption, width_in=_FIGURE_WIDTH_IN),)
    return ReportSection(
        title=f"Changes: {name}",
        text=tuple(text),
        tables=(list_table(summary.changes[:_LISTED]),) if summary.changes else (),
        figures=figures,
    )


def stored_pose_section(name: str, verdict: PoseSummary) -> ReportSection:
    """Show a stored pose.json; ``name`` is that of its file or folder."""
    rows: tuple[tuple[str, str], ...] = (
        ("d' by the criterion", f"{verdict.dprime_decisive:.2f}"),
        ("threshold", f"{verdict.min_dprime:g}"),
        ("local zoom", f"{verdict.zoom_min:.3f} to {verdict.zoom_max:.3f}"),
        ("anisotropy, up to", f"{verdict.anisotropy_max:.3f}"),
        ("overlap", f"{100 * verdict.overlap:.0f} % of the follow-up"),
    )
    if verdict.verdict is not None and verdict.probability is not None:
        rows = (
            ("verdict", verdict.verdict),
            ("probability that d' reaches the threshold", f"{100 * verdict.probability:.1f} %"),
            *rows,
            *(
                (f"share of {one.source} in the uncertainty", f"{100 * one.share:.0f} %")
                for one in verdict.budget
            ),
        )
    text = [
        f"The pose is {'accepted' if verdict.is_accepted else 'rejected'} by criterion "
        f"{verdict.criterion}. d' is an upper bound: registration, light, gloss, parallax and "
        "defocus only lower it."
    ]
    text += [f"Warning: {warning}." for warning in verdict.warnings]
    return ReportSection(
        title=f"Pose: {name}",
        text=tuple(text),
        tables=(ReportTable(columns=("", "value"), rows=rows),),
    )
