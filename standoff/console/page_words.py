"""What is wrong, in words of a page: a browser has no command line, and its fields have names."""

import re
from collections.abc import Sequence

from pydantic import ValidationError
from pydantic_core import ErrorDetails

_OF_THE_PAGE = (
    (
        re.compile(r"^--force replaces .*$"),
        "to replace it, tick “replace” or press “Compute again”",
    ),
    (re.compile(r"\b(?:run|give|type) the same command again\b.*$"), "start it again"),
    (re.compile(r"^the same command goes on"), "started again, it goes on"),
    (re.compile(r"\band run (?:it )?again$"), "and start it again"),
)
_USAGE = re.compile(r"^Invalid value(?: for '?--[a-z-]+'?)?: ")
_OF_A_TERMINAL = re.compile(
    r"(?<![\w-])--[a-z][a-z-]+|`standoff |\bstandoff [a-z-]+ [A-Za-z-]|\bpip install\b"
)

_IN_A_TERMINAL = "in a terminal: "


def page_words(text: str) -> str:
    """Return a sentence of a command with the remedies that a page has.

    What was found wrong stands before the first semicolon, and stays as it is.
    """
    fault, *remedies = _USAGE.sub("", text).split("; ")
    return "; ".join([fault, *(_remedy(each) for each in remedies)])


def _remedy(clause: str) -> str:
    for pattern, words in _OF_THE_PAGE:
        if pattern.search(clause):
            return pattern.sub(words, clause)
    is_told = clause.startswith(_IN_A_TERMINAL) or "console" in clause
    return clause if is_told or not _OF_A_TERMINAL.search(clause) else _IN_A_TERMINAL + clause


_TYPED = {
    "exposure_us": ("exposure", " µs"),
    "gain_db": ("gain", " dB"),
    "height_mm": ("height", " mm"),
    "low_mm": ("lowest height", " mm"),
    "high_mm": ("highest height", " mm"),
    "steps": ("number of heights", ""),
    "frames": ("number of frames", ""),
    "plan": ("plan's name", ""),
    "session": ("session's name", ""),
    "reference_session": ("other session's name", ""),
    "index": ("number of the capture", ""),
    "followup": ("number of the capture", ""),
    "reference": ("number of the other capture", ""),
    "min_dprime": ("threshold of d'", ""),
    "reason": ("reason", ""),
    "text": ("answer", ""),
    "name": ("name", ""),
    "kind": ("kind of photograph", ""),
}
"""Fields that an operator types in or chooses: their names on the page, and their units."""

_DRAFT = {
    "name": ("plan's name", ""),
    "heights": ("heights", ""),
    "frames": ("frames of a capture", ""),
    "repeats": ("repeats", ""),
    "settle_s": ("wait after a move", " s"),
    "targets": ("targets", ""),
    "kind": ("kind", ""),
    "target": ("name of a target", ""),
    "orientations": ("orientations", ""),
    "exposures": ("exposures", ""),
    "bracket_exposures": ("exposures of the bracket", ""),
    "bracket_ratio": ("ratio of the bracket", ""),
    "reference": ("photograph to compare with", ""),
}
"""The same of the plan editor."""

_REQUIREMENTS = {
    "missing": "must be given",
    "greater_than": "must be more than {gt:.9g}{unit}",
    "greater_than_equal": "must be at least {ge:.9g}{unit}",
    "less_than": "must be less than {lt:.9g}{unit}",
    "less_than_equal": "must be at most {le:.9g}{unit}",
    "string_too_long": "must be at most {max_length} characters long",
    "string_type": "must be text",
    "string_unicode": "must be text",
    "too_long": "must have at most {max_length} entries",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a smaller number",
    "int_from_float": "must be a whole number",
    "literal_error": "must be {expected}",
}
"""What each kind of fault asks for; of `pydantic`, which has words of its own for programmers."""

_EMPTY = ("string_too_short", "too_short")

NOT_UNDERSTOOD = "This page is from another version of the console: reload it."
"""Of what no operator typed: a page sends it only if it is older or newer than the console."""


def requirement(fault: ErrorDetails, unit: str = "") -> str:
    """What a value must be, as in ``must be at least 7``; with a colon, what is wrong with it."""
    facts = fault.get("ctx", {})
    if "error" in facts:
        return f": {facts['error']}"
    if fault["type"] in _EMPTY:
        least = facts["min_length"]
        return " must not be empty" if least == 1 else f" must have at least {least} entries"
    text = _REQUIREMENTS.get(fault["type"], "cannot be used as it is")
    return f" {text.format(unit=unit, **facts)}"


def field_at_fault(error: ValidationError) -> str:
    """The key of the field whose value is the first at fault; empty if that is no field's."""
    loc = error.errors()[0]["loc"][1:]  # the first part is the kind of message
    return ".".join(map(str, loc))


def words_of_fault(error: ValidationError) -> str:
    """What is wrong with the first value at fault of a message, for an operator."""
    fault = error.errors()[0]
    names = [part for part in fault["loc"][1:] if isinstance(part, str)]
    known = _DRAFT if names[:1] == ["draft"] else _TYPED
    name, unit = known.get(names[-1] if names else "", ("", ""))
    if not name or fault["type"] == "extra_forbidden":
        return NOT_UNDERSTOOD
    where = _target_of(fault["loc"])
    return f"The {name}{where}{requirement(fault, unit)}."


def _target_of(loc: Sequence[int | str]) -> str:
    """Which target of a plan a value is of."""
    number = next((part for part in loc if isinstance(part, int)), None)
    return "" if number is None else f" of target {number + 1}"
