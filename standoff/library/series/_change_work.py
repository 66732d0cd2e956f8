"""Changes of many follow-ups: each gets a folder with the files of a single comparison."""

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from acquisition.files import make_folder
from acquisition.photographs import Photograph
from acquisition.printable import on_one_line
from analysis.change_series import ComparedFollowup, limit_columns
from analysis.changes import ChangeCriteria
from analysis.followup_series import FolderNames, FollowupWork, Written
from analysis.sweep import SweepItem
from simulation import Psf, PsfField
from simulation.choices import PsfShape
from standoff.library.changes import (
    CHANGE_FILES,
    DEPTH_FILES,
    ComparedPhotographs,
    ComparisonRules,
    compared,
    write_changes,
)
from standoff.library.registration import hint_settings
from standoff.library.swept_photographs import refusing

_CRITERIA = tuple(one.name for one in fields(ChangeCriteria))
_SETTING = {"least_dn": "least"}
"""Under which name a criterion is a setting, where it is not its own."""


@dataclass(frozen=True, kw_only=True)
class ChangeWork(FollowupWork[ComparedPhotographs]):
    """Finds the changes of follow-ups.

    Parameters
    ----------
    psf, field
        The camera's PSF and its field, if they are known; the field is for whole frames of its
        size.
    rules, shape
        How two photographs are compared, and which PSF of a calibration is used.
    names
        Names of the folders.
    """

    listed = ComparedFollowup

    psf: Psf | None
    field: PsfField | None
    rules: ComparisonRules
    shape: PsfShape
    names: FolderNames

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the work, without the contents of psf.json, noise.json and hint files."""
        options, hints = self.rules.options, self.rules.hints
        return {
            "command": "changes",
            "psf": self.psf is not None,
            "noise": options.noise is not None,
            "transfer": self.shape,
            **{_SETTING.get(name, name): getattr(options, name) for name in _CRITERIA},
            "hints": hint_settings(hints),
            "white_level": self.rules.white_level,
            "spot_sigma_px": options.spot_sigma_px,
            "limit_contrast_dn": options.limit_contrast_dn,
            "limit_rgb": options.limit_rgb,
            "scale": asdict(self.rules.scale),
            "expected": None if options.expected is None else asdict(options.expected),
        }

    def find(self, near: Photograph, photograph: Photograph) -> ComparedPhotographs:
        """Find the changes of one follow-up."""
        psf = self._field_for(near, photograph) or self.psf
        with refusing():
            return compared(near, photograph, psf, self.rules)

    def write(self, photograph: Photograph, found: ComparedPhotographs) -> Written:
        """Write the folder of one follow-up."""
        name = self.names.name_of(photograph.path)
        own_reference = self.references.name_for(photograph.path)
        folder = make_folder(self.out / name)
        both = (found.reference, photograph)
        summary = found.summary.model_copy(
            update={
                "reference": own_reference or self.references.name,
                "followup": on_one_line(photograph.path),
                "provenance": self.provenance_with(*both[own_reference is None :]),
            }
        )
        write_changes(folder, replace(found, summary=summary))
        row = ComparedFollowup(
            followup=on_one_line(photograph.path),
            sha256=photograph.sha256,
            folder=name,
            changed_px=summary.changed_px,
            compared_px=summary.compared_px,
            zoom=summary.zoom,
            threshold_sd=summary.threshold_sd,
            changes=len(summary.changes),
            moved=len(summary.moved),
            taken=photograph.facts.taken,
            warnings="; ".join(summary.warnings) or None,
            reference=own_reference,
        ).model_copy(update=limit_columns(summary))
        return Written(
            row=row.model_dump(),
            files=tuple(
                folder / file
                for file in CHANGE_FILES
                if file in found.depth_maps or file not in DEPTH_FILES
            ),
            notes=self._note_on_field(found),
        )

    def state_of(self, item: SweepItem) -> str:
        """Say which reference it has, and the folder: another photograph may change its name."""
        return super().state_of(item) + json.dumps(self.names.name_of(item.path))

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

    def _note_on_field(self, pair: ComparedPhotographs) -> dict[str, str]:
        if self.field is None or self._field_for(pair.reference, pair.followup):
            return {}
        sentence = (
            f"{on_one_line(pair.followup.path)}: the PSF's field belongs to frames of "
            f"{self.field.width_px} x {self.field.height_px} px; one PSF is used"
        )
        return {"field": sentence}


def _shape(field: PsfField) -> tuple[int, int]:
    return field.height_px, field.width_px
