"""The provenance of what is made from a capture session or from other results."""

from pathlib import Path

from acquisition.session import Session
from calibration.provenance import Provenance
from standoff.photographs import Inputs
from standoff.terminal import command_line


def provenance_of(session: Session | None, *files: Path | None) -> Provenance:
    """Return the provenance of what the command at work makes from a session, files, or both.

    Raises
    ------
    ImageFileError
        If a file cannot be read.
    """
    inputs = Inputs()
    if session is not None:
        inputs.add_session(session)
    for path in files:
        inputs.add(path)
    return inputs.provenance(command_line())
