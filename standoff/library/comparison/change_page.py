"""The page that shows what changed between two photographs."""

from analysis.changes import ChangeResult, ChangeSummary
from analysis.reports import compared_pictures, render_changes_report, view_figures
from simulation.arrays import BoolArray
from standoff.photographs import Photograph


def page_of_changes(
    near: Photograph,
    far: Photograph,
    found: ChangeResult,
    summary: ChangeSummary,
    left_out: BoolArray | None = None,
) -> str:
    """Return the report of a comparison as one HTML document.

    Parameters
    ----------
    near, far
        Reference and follow-up.
    found, summary
        What the comparison found; the summary has the names and the provenance.
    left_out
        Follow-up pixels that the operator left out, if any.
    """
    rows, cols = found.followup_dn.shape
    pictures = compared_pictures(near.grey_dn, found, left_out)
    return render_changes_report(
        summary,
        view_figures(pictures, summary.changes, (cols, rows)),
        (("before, taken", _taken(near)), ("after, taken", _taken(far))),
    )


def _taken(photograph: Photograph) -> str:
    return photograph.facts.taken or "not stated"
