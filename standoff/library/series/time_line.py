"""Writes what several follow-ups say together: the time line of each change, and a page."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from acquisition.untrusted import TIFF_DAMAGE
from analysis.change_series import (
    ChangesSeries,
    ChangeTimeLine,
    ComparedFollowup,
    PlaceReading,
    TimeLineFollowup,
    track_changes,
)
from analysis.changes import Change, ChangeSummary, read_changes
from analysis.errors import ResultsFileError
from analysis.reports import render_series_report
from analysis.results_file import write_results
from calibration.registration import DistortedPose
from simulation.arrays import Float32Array, FloatArray
from standoff.library.call import Call
from standoff.library.files import write_file, write_page
from standoff.library.series.rows import Row

TIME_LINE_NAME, PAGE_NAME = "series.json", "report.html"

_TIME_LINE_MOST = 500
"""Follow-ups of a time line: it says something of every track in every follow-up."""

_ON_PAGE_MOST = 1000


@dataclass(frozen=True, kw_only=True)
class _StoredComparison:
    """A follow-up's results as the tracks need them; its maps stay on disk."""

    row: ComparedFollowup
    summary: ChangeSummary
    folder: Path
    reference_shape: tuple[int, int]

    @property
    def changes(self) -> tuple[Change, ...]:
        return self.summary.changes

    @property
    def zoom(self) -> float:
        return self.summary.zoom

    def place_of(self, reference_x_px: float, reference_y_px: float) -> tuple[float, float]:
        y_px, x_px = self._pose.to_followup_px(np.array(reference_y_px), np.array(reference_x_px))
        return float(x_px), float(y_px)

    def reading_at(self, x_px: float, y_px: float) -> PlaceReading | None:
        if not np.isfinite([x_px, y_px]).all():
            return None
        row, col = round(y_px), round(x_px)
        rows, cols = self._sd_dn.shape
        if not (0 <= row < rows and 0 <= col < cols) or not self._sd_dn[row, col] > 0:
            return None
        return PlaceReading(
            significance=float(self._significance[row, col]), sd_dn=float(self._sd_dn[row, col])
        )

    @cached_property
    def _pose(self) -> DistortedPose:
        rows, cols = self._sd_dn.shape
        return DistortedPose(
            matrix=np.array(self.summary.homography),
            k1=self.summary.distortion_k1,
            reference_shape=self.reference_shape,
            followup_shape=(rows, cols),
        )

    @cached_property
    def _significance(self) -> Float32Array:
        return _mapped(self.folder / "significance.tif")

    @cached_property
    def _sd_dn(self) -> Float32Array:
        return _mapped(self.folder / "uncertainty.tif")


def write_series_page(
    call: Call,
    out: Path,
    report: Path | None,
    series: ChangesSeries,
    rows: Iterable[Row],
    reference_dn: FloatArray | None,
) -> None:
    """Write the time line of the changes, if they have one reference, and a page on all.

    Parameters
    ----------
    call
        Takes the notes.
    out
        Folder that holds the follow-ups' own.
    report
        Where the page goes, too; None for the folder alone.
    series
        Their summary, without its lines.
    rows
        Its lines.
    reference_dn
        The reference that all share; None for pairs.

    Raises
    ------
    ApplicationError, ResultsFileError
        If results cannot be read or written.
    """
    listed = [ComparedFollowup.model_validate(row) for row in islice(rows, _ON_PAGE_MOST)]
    line = None
    if reference_dn is not None and series.compared <= _TIME_LINE_MOST:
        line = _time_line(out, series, rows, reference_dn.shape)
        write_results(out / TIME_LINE_NAME, line)
    elif reference_dn is not None:
        call.note(
            f"no time line of more than {_TIME_LINE_MOST} follow-ups; each has its changes.json"
        )
    page = render_series_report(series, listed, line, reference_dn)
    write_file(out / PAGE_NAME, page.encode("utf-8"))
    if report is not None:
        write_page(report, page)


def _time_line(
    out: Path, series: ChangesSeries, rows: Iterable[Row], shape: tuple[int, ...]
) -> ChangeTimeLine:
    given = [ComparedFollowup.model_validate(row) for row in rows if row["refused"] is None]
    is_by_time = bool(given) and all(one.taken for one in given)
    if is_by_time:
        given.sort(key=lambda one: (one.taken or "", one.followup))
    stored = [_stored(out, one, (shape[0], shape[1])) for one in given]
    return ChangeTimeLine(
        reference=series.reference,
        order="time" if is_by_time else "path",
        followups=tuple(
            TimeLineFollowup(
                followup=one.row.followup,
                folder=one.row.folder or "",
                taken=one.row.taken,
                changes=len(one.changes),
            )
            for one in stored
        ),
        tracks=track_changes(stored),
        provenance=series.provenance,
    )


def _stored(out: Path, row: ComparedFollowup, shape: tuple[int, int]) -> _StoredComparison:
    folder = out / (row.folder or "")
    return _StoredComparison(
        row=row,
        summary=read_changes(folder / "changes.json"),
        folder=folder,
        reference_shape=shape,
    )


def _mapped(path: Path) -> Float32Array:
    """The pixels of a map, of which only those that are looked at are read."""
    try:
        mapped: Any = tifffile.memmap(path, mode="r")
    except TIFF_DAMAGE as error:
        raise ResultsFileError(
            f"{path}: not a map of standoff changes", source=str(path)
        ) from error
    return np.asarray(mapped)
