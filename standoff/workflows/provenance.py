"""The provenance of what is made from a capture session or from results."""

from pathlib import Path

from acquisition.session import Session
from calibration.provenance import Provenance
from standoff.photographs import Inputs
from standoff.terminal import command_line


def session_provenance(session: Session, *files: Path | None) -> Provenance:
    """Return the provenance of what the command at work makes from a session and further files.

    Raises
    ------
    ApplicationError
        If a file cannot be read.
    """
    inputs = Inputs()
    inputs.add_session(session)
    for path in files:
        inputs.add(path)
    return inputs.provenance(command_line())


def files_provenance(*files: Path | None) -> Provenance:
    """Return the provenance of what the command at work makes from other results.

    Raises
    ------
    ApplicationError
        If a file cannot be read.
    """
    inputs = Inputs()
    for path in files:
        inputs.add(path)
    return inputs.provenance(command_line())
