"""What is wrong with a value that an operator typed in, in the words of the page."""

from pydantic import ValidationError

_TYPED = {
    "exposure_us": ("exposure", " µs"),
    "gain_db": ("gain", " dB"),
    "height_mm": ("height", " mm"),
    "low_mm": ("lowest height", " mm"),
    "high_mm": ("highest height", " mm"),
    "steps": ("number of heights", ""),
    "session": ("session's name", ""),
    "min_dprime": ("threshold of d'", ""),
    "reason": ("reason", ""),
    "text": ("answer", ""),
}
"""Fields that an operator types in: their names on the page, and their units."""

_LIMITS = {
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:.9g}",
    "string_too_short": "at least {min_length} characters long",
    "string_too_long": "at most {max_length} characters long",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
}


def words_of_fault(error: ValidationError) -> str:
    """What is wrong with the number or text that an operator typed in; empty if it is not that."""
    fault = error.errors()[0]
    name, unit = _TYPED.get(str(fault["loc"][-1]) if fault["loc"] else "", ("", ""))
    limit = _LIMITS.get(fault["type"], "").format(**fault.get("ctx", {}))
    return f"The {name} must be {limit}{unit}." if name and limit else ""
