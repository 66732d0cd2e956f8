"""A command's ``--json`` and the library's result are one document."""

import json
from typing import Any

from tests.standoff.conftest import Outcome

_OF_THE_COMMAND_LINE = ("out",)


def printed(done: Outcome) -> Any:
    """What a command printed, without who made it and when, and where it was written."""
    assert done.status == 0, done.err
    return without_caller(json.loads(done.out))


def without_caller(document: dict[str, Any]) -> dict[str, Any]:
    """A document without who made it and when."""
    plain: dict[str, Any] = json.loads(json.dumps(document, allow_nan=False))
    for name in _OF_THE_COMMAND_LINE:
        plain.pop(name, None)
    provenance = plain.get("provenance")
    if provenance is not None:
        assert provenance.pop("command")
        assert provenance.pop("created")
    return plain
