"""The demo on a photograph in colour, from which somebody took a paper lantern away."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from acquisition.files import make_folder, write_file
from analysis.reports import (
    ReportSection,
    changes_section,
    compared_pictures,
    count_text,
    view_figures,
)
from standoff.library.call import Call
from standoff.library.changes import ComparedPhotographs, find_changes
from standoff.library.photographs import example_photographs

LANTERN_PHOTOGRAPHS = "photographs/lantern-before.jpg", "photographs/lantern-after.jpg"
"""Files below the demo's folder: the photograph with the lantern, and the one without."""


@dataclass(frozen=True, kw_only=True)
class TakenAway:
    """Two photographs from one place, between which one thing went; and what was found."""

    found: ComparedPhotographs

    @property
    def sentence(self) -> str:
        """What was listed, in one line."""
        changes = self.found.summary.changes
        entries = "; ".join(
            f"{change.what} at ({change.x_px:.0f}, {change.y_px:.0f}), {change.area_px:.0f} px"
            for change in changes
        )
        return (
            "a photograph in colour from which somebody took a paper lantern: "
            f"{count_text(len(changes))}{f', {entries}' if entries else ''}"
        )

    def to_json(self) -> list[dict[str, Any]]:
        """Return what was listed as ``standoff demo --json`` prints it."""
        return [
            {
                "what": change.what,
                "x_px": change.x_px,
                "y_px": change.y_px,
                "area_px": change.area_px,
            }
            for change in self.found.summary.changes
        ]

    def section(self) -> ReportSection:
        """Return what changed, for a report."""
        found = self.found
        rows, cols = found.followup_dn.shape
        pictures = compared_pictures(found.reference.grey_dn, found, None, found.colours)
        views = view_figures(pictures, found.summary.changes, (cols, rows), found.summary.moved)
        changes = changes_section(found.summary, views)
        count = count_text(len(found.summary.changes))
        return replace(
            changes,
            title="In colour: what was taken away",
            text=(
                "A roof with a paper lantern, and the photograph after somebody had taken the "
                "lantern away with a program that fills in what it hid, and saved it as a JPEG "
                f"again (IOPaint, Apache licence 2.0). One thing is gone; standoff lists {count}.",
                *changes.text,
            ),
        )


def compare_lantern(call: Call, out: Path) -> TakenAway:
    """Write the two photographs below ``out``, and compare them."""
    examples = example_photographs()
    paths = tuple(out / name for name in LANTERN_PHOTOGRAPHS)
    make_folder(paths[0].parent)
    for path, example in zip(paths, (examples.before, examples.after), strict=True):
        write_file(path, example.read_bytes())
    with call.bar("comparing in colour", 1) as advance_to:
        found = find_changes(*paths)
        advance_to(1)
    return TakenAway(found=found)
