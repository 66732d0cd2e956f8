"""Changes of many follow-ups: each gets a folder with the files of a single comparison."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from acquisition.printable import on_one_line
from analysis.change_series import ComparedFollowup
from analysis.sweep import SweepItem
from simulation import Psf, PsfField
from standoff.photographs import Photograph
from standoff.workflows.comparison import (
    CHANGE_FILES,
    ComparedPair,
    ComparisonRequest,
    compared,
    write_changes,
)
from standoff.workflows.followup_series.folder_names import FolderNames
from standoff.workflows.followup_series.record import FollowupRecord
from standoff.workflows.followup_series.work import FollowupWork, Written
from standoff.workflows.output_files import make_folder


@dataclass(frozen=True, kw_only=True)
class ChangeWork(FollowupWork[ComparedPair]):
    """Finds the changes of follow-ups.

    Parameters
    ----------
    psf, field
        Of the camera, if they are known; the field is for whole frames of its size.
    request
        How two photographs are compared.
    names
        Names of the folders.
    """

    listed = ComparedFollowup

    psf: Psf | None
    field: PsfField | None
    request: ComparisonRequest
    names: FolderNames

    @property
    def settings(self) -> dict[str, Any]:
        """What is done, apart from the contents of psf.json, noise.json and the hints' files."""
        request = self.request
        return {
            "command": "changes",
            "psf": request.psf is not None,
            "noise": request.options.noise is not None,
            "transfer": request.transfer,
            "false_alarms": request.options.false_alarms,
            "false_discovery_rate": request.options.false_discovery_rate,
            "hints": request.hints.settings,
            "white_level": request.white_level,
        }

    def find(self, near: Photograph, photograph: Photograph) -> ComparedPair:
        """Find the changes of one follow-up."""
        psf = self._field_for(near, photograph) or self.psf
        return compared(near, photograph, psf, self.request)

    def write(self, photograph: Photograph, found: ComparedPair) -> Written:
        """Write the folder of one follow-up."""
        name = self.names.name_of(photograph.path)
        own_reference = self.references.name_for(photograph.path)
        folder = make_folder(self.out / name)
        both = (found.reference, photograph)
        summary = found.found.summary.model_copy(
            update={
                "reference": own_reference or self.references.name,
                "followup": on_one_line(photograph.path),
                "provenance": self.provenance_with(*both[own_reference is None :]),
            }
        )
        write_changes(folder, found, summary)
        row = ComparedFollowup(
            followup=on_one_line(photograph.path),
            sha256=photograph.sha256,
            folder=name,
            changed_px=summary.changed_px,
            compared_px=summary.compared_px,
            zoom=summary.zoom,
            threshold_sd=summary.threshold_sd,
            changes=len(summary.changes),
            taken=photograph.facts.taken,
            warnings="; ".join(summary.warnings) or None,
            reference=own_reference,
        )
        return Written(
            row=row.model_dump(),
            files=tuple(folder / file for file in CHANGE_FILES),
            notes=self._note_on_field(found),
        )

    def is_current(self, item: SweepItem, record: FollowupRecord) -> bool:
        """Whether the folder has the name that it would get now."""
        return record.is_refused or record.row["folder"] == self.names.name_of(item.path)

    def discard(self, item: SweepItem) -> None:
        """Remove the files of an earlier comparison, and the folder if it held nothing else."""
        folder = self.out / self.names.name_of(item.path)
        for file in CHANGE_FILES:
            (folder / file).unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()

    def _field_for(self, near: Photograph, far: Photograph) -> PsfField | None:
        """The field, if reference and follow-up are whole frames of its size."""
        field = self.field
        if field is None or not near.stored.shape[:2] == far.stored.shape[:2] == _shape(field):
            return None
        return field

    def _note_on_field(self, pair: ComparedPair) -> dict[str, str]:
        if self.field is None or self._field_for(pair.reference, pair.followup):
            return {}
        sentence = (
            f"{on_one_line(pair.followup.path)}: the PSF's field belongs to frames of "
            f"{self.field.width_px} x {self.field.height_px} px; one PSF is used"
        )
        return {"field": sentence}


def _shape(field: PsfField) -> tuple[int, int]:
    return field.height_px, field.width_px
