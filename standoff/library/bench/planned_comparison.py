"""Captures compared with an earlier photograph that the plan names: pose at once, changes after."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from acquisition.photographs import Photograph, read_image
from acquisition.plan import CapturePlan
from acquisition.printable import on_one_line
from acquisition.session import CaptureRecord, Session
from analysis.pose import describe_pose
from calibration.errors import RegistrationError
from calibration.registration import register
from standoff.library.call import Progress
from standoff.library.files import RESULTS_FOLDER, make_folder, make_results_folder
from standoff.library.series import find_changes_of_series

COMPARISONS_FOLDER = "changes"
"""Folder of a session's results for the comparisons, one folder a target in it."""

Target = tuple[str, str]
"""Kind and name of a target."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedComparisons:
    """What a session's captures are compared with, by target.

    Parameters
    ----------
    session
        Folder of the session.
    references
        Photographs by kind and name of the target; empty where the plan names none.
    """

    session: Path
    references: Mapping[Target, Photograph] = field(default_factory=dict)

    @classmethod
    def of(cls, plan: CapturePlan, folder: Path, session: Path) -> Self:
        """Read the photographs that a plan in ``folder`` names.

        Raises
        ------
        ImageFileError
            If one cannot be read: before anything moves.
        """
        return cls(
            session=session,
            references={
                (target.kind, target.target): read_image(folder / target.reference)
                for target in plan.targets
                if target.reference is not None
            },
        )

    def pose_sentence(self, record: CaptureRecord) -> str | None:
        """Say how a capture's pose compares with its reference; None if it has none."""
        reference = self.references.get((record.kind, record.target))
        if reference is None:
            return None
        capture = Session(self.session).load(record).mean_dn
        name = on_one_line(reference.path.name)
        try:
            found = register(reference.grey_dn, capture)
        except RegistrationError as error:
            return f"not recognised in {name}: {error}"
        return f"against {name}: {describe_pose(found.pose)}"

    def write(self, progress: Progress | None = None) -> tuple[str, ...]:
        """Compare all captures with their references; return where the results are.

        They are resumed: what was compared before is not compared again.

        Raises
        ------
        ApplicationError, CalibrationError, SessionError
            If files cannot be read or written.
        """
        if not self.references:
            return ()
        session = Session(self.session)
        psf = self.session / RESULTS_FOLDER / "psf.json"
        said = []
        for (kind, target), reference in self.references.items():
            captures = tuple(
                self.session / one.record.file
                for one in session.captures
                if (one.record.kind, one.record.target) == (kind, target)
                and not one.is_superseded
                and one.excluded_because is None
            )
            if not captures:
                continue
            out = self.session / RESULTS_FOLDER / COMPARISONS_FOLDER / _folder_name(kind, target)
            make_results_folder(self.session)
            document = find_changes_of_series(
                reference.path,
                captures,
                make_folder(out),
                psf if psf.is_file() else None,
                progress=progress,
            ).document
            if document is not None:
                lost = f", {document.refused} not recognised" if document.refused else ""
                said.append(
                    f"{target}: {document.changed} of {document.compared} captures differ from "
                    f"{on_one_line(reference.path.name)}{lost}; see "
                    f"{on_one_line(out / 'report.html')}"
                )
        return tuple(said)


def _folder_name(kind: str, target: str) -> str:
    safe = "".join(letter if letter.isalnum() else "-" for letter in target)
    return f"{kind}-{safe}"
