"""The comparisons of a series as they lie on disk, and the time line of their changes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from acquisition.untrusted import TIFF_DAMAGE
from analysis.change_series.summary import ChangesSeries, ComparedFollowup
from analysis.change_series.time_line import ChangeTimeLine, TimeLineFollowup
from analysis.change_series.tracks import PlaceReading, track_changes
from analysis.changes import Change, ChangeSummary, read_changes
from analysis.errors import ResultsFileError
from calibration.registration import DistortedPose
from simulation.arrays import Float32Array


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
        sd_dn = float(self._sd_dn[row, col])
        # Not significance.tif, which is of the width at which each place stands out most.
        return PlaceReading(significance=float(self._difference_dn[row, col]) / sd_dn, sd_dn=sd_dn)

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
    def _difference_dn(self) -> Float32Array:
        return _mapped(self.folder / "difference.tif")

    @cached_property
    def _sd_dn(self) -> Float32Array:
        return _mapped(self.folder / "uncertainty.tif")


def time_line_of(
    out: Path,
    series: ChangesSeries,
    rows: Iterable[Mapping[str, Any]],
    reference_shape: tuple[int, ...],
) -> ChangeTimeLine:
    """Return the time line of the changes of all follow-ups that could be compared.

    Parameters
    ----------
    out
        Folder that holds the follow-ups' own.
    series
        Their summary, without its lines.
    rows
        Its lines.
    reference_shape
        ``(rows, cols)`` of the reference that all share.

    Raises
    ------
    ResultsFileError
        If the results of a follow-up cannot be read.
    """
    rows_px, cols_px = reference_shape[:2]
    given = [ComparedFollowup.model_validate(row) for row in rows if row["refused"] is None]
    is_by_time = bool(given) and all(one.taken for one in given)
    if is_by_time:
        given.sort(key=lambda one: (one.taken or "", one.followup))
    stored = [_stored(out, one, (rows_px, cols_px)) for one in given]
    return ChangeTimeLine(
        reference=series.reference,
        order="time" if is_by_time else "path",
        followups=tuple(
            TimeLineFollowup(
                followup=one.row.followup,
                folder=one.row.folder or "",
                taken=one.row.taken,
                changes=len(one.changes),
                detection_limit=one.summary.detection_limit,
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
