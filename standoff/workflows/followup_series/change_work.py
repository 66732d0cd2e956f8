"""Changes of many follow-ups: each gets a folder with the files of a single comparison."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from acquisition.printable import on_one_line
from analysis.changes import ChangeOptions, ChangeResult, ComparedFollowup
from analysis.sweep import SweepItem
from simulation import Psf, PsfField
from simulation.arrays import FloatArray
from simulation.choices import PsfShape
from standoff.photographs import Photograph
from standoff.workflows.change_search import CHANGE_FILES, compared, write_changes
from standoff.workflows.followup_series.folder_names import FolderNames
from standoff.workflows.followup_series.record import FollowupRecord
from standoff.workflows.followup_series.work import FollowupWork, Written
from standoff.workflows.output_files import make_folder


@dataclass(frozen=True, kw_only=True)
class ChangeWork(FollowupWork[ChangeResult]):
    """Finds the changes of follow-ups.

    Parameters
    ----------
    psf, field
        Of the camera; the field is for whole frames of its size.
    transfer
        Which PSF of the file they are.
    options
        How two photographs are compared.
    names
        Names of the folders.
    """

    listed = ComparedFollowup

    psf: Psf
    field: PsfField | None
    transfer: PsfShape
    options: ChangeOptions
    names: FolderNames

    @property
    def settings(self) -> dict[str, Any]:
        """What is done, apart from the contents of psf.json and noise.json."""
        return {
            "command": "changes",
            "transfer": self.transfer,
            "false_alarms": self.options.false_alarms,
        }

    def find(self, near: FloatArray, photograph: Photograph) -> ChangeResult:
        """Find the changes of one follow-up."""
        far = photograph.grey_dn
        psf = self._field_for(far) or self.psf
        return compared(near, far, psf, self.options, photograph.path)

    def write(self, photograph: Photograph, found: ChangeResult) -> Written:
        """Write the folder of one follow-up."""
        name = self.names.name_of(photograph.path)
        folder = make_folder(self.out / name)
        summary = found.summary.model_copy(
            update={
                "reference": self.reference.name,
                "followup": on_one_line(photograph.path),
                "provenance": self.provenance_with(photograph),
            }
        )
        write_changes(folder, photograph.path.name, found, summary)
        row = ComparedFollowup(
            followup=on_one_line(photograph.path),
            sha256=photograph.sha256,
            folder=name,
            changed_px=summary.changed_px,
            compared_px=summary.compared_px,
            zoom=summary.zoom,
            threshold_sd=summary.threshold_sd,
        )
        return Written(
            row=row.model_dump(),
            files=tuple(folder / file for file in CHANGE_FILES),
            notes=self._note_on_field(photograph, found),
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

    def _field_for(self, far: FloatArray) -> PsfField | None:
        """The field, if reference and follow-up are whole frames of its size."""
        field = self.field
        if field is None or not self.reference.shape == far.shape == _shape(field):
            return None
        return field

    def _note_on_field(self, photograph: Photograph, found: ChangeResult) -> dict[str, str]:
        if self.field is None or self._field_for(found.followup_dn):
            return {}
        sentence = (
            f"{on_one_line(photograph.path)}: the PSF's field belongs to frames of "
            f"{self.field.width_px} x {self.field.height_px} px; one PSF is used"
        )
        return {"field": sentence}


def _shape(field: PsfField) -> tuple[int, int]:
    return field.height_px, field.width_px
