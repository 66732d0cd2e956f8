"""Lists of numbers on the command line, where commas separate and a decimal comma is a slip."""

import math
import re
from dataclasses import dataclass
from itertools import pairwise

from typer import BadParameter

from standoff.terminal.output import note


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedNumbers:
    """What the numbers of an option may be: from ``least``, or above 0.

    Of two whole numbers, the second is probably a decimal if it is ``pair_most`` or more.
    """

    option: str
    least: float | None = None
    pair_most: float | None = None

    @property
    def bound(self) -> str:
        """The bound in words."""
        return "above 0" if self.least is None else f"of at least {self.least:g}"

    def accepts(self, value: float) -> bool:
        """Whether a value is finite and within the bound."""
        is_within = value > 0 if self.least is None else value >= self.least
        return math.isfinite(value) and is_within


def number_list(text: str, listed: ListedNumbers) -> list[float]:
    """Read numbers separated by commas, each once, in the order in which they are written."""
    meant = decimals_meant(text, listed)
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        remedy = "" if meant is None else f"; write {meant}, with commas between the numbers only"
        raise BadParameter(
            f"expected numbers, got {text}{remedy}", param_hint=listed.option
        ) from error
    refused = next((value for value in values if not listed.accepts(value)), None)
    if meant is not None:
        confirmed = ",".join(f"{value:.1f}" for value in values)
        otherwise = f", or {confirmed} if they are right" if refused is None else ""
        raise BadParameter(
            f"{text} is {len(values)} numbers; decimals were probably meant: "
            f"write {meant}{otherwise}",
            param_hint=listed.option,
        )
    if refused is not None:
        raise BadParameter(
            f"expected numbers {listed.bound}, got {refused:g}", param_hint=listed.option
        )
    if listed.pair_most is not None and re.fullmatch(r"\d,\d", text):
        whole, fraction = text.split(",")
        note(
            f"{listed.option} {text} is two numbers, {whole} and {fraction}; "
            f"a single one is written {whole}.{fraction}"
        )
    return list(dict.fromkeys(values))


def decimals_meant(text: str, listed: ListedNumbers) -> str | None:
    """The list with decimal points for its decimal commas; None if nothing says that it has any.

    A list with a point in it is taken as it is. Signs of a decimal comma are another separator
    beside it, a leading zero (``1,05``), a number out of bounds, a second of two numbers that is
    too large, and pairs that ascend where the numbers do not (``1,5,2,5``).
    """
    parts = re.split(r"[;\s]+", text.strip())
    if "," in text and len(parts) > 1 and all(re.fullmatch(r"\d+(,\d+)?", one) for one in parts):
        return ",".join(part.replace(",", ".") for part in parts)
    words = text.split(",")
    if len(words) % 2 or not all(re.fullmatch(r"\d{1,9}", word) for word in words):
        return None
    joined = [
        f"{whole}.{fraction}" for whole, fraction in zip(words[::2], words[1::2], strict=True)
    ]
    decimals = [float(one) for one in joined]
    is_meant = _has_decimal_commas(words, decimals, listed) and all(map(listed.accepts, decimals))
    return ",".join(joined) if is_meant else None


def _has_decimal_commas(words: list[str], decimals: list[float], listed: ListedNumbers) -> bool:
    """Whether whole numbers make less sense than the decimals that their pairs would be."""
    numbers = [float(word) for word in words]
    if any(len(word) > 1 and word.startswith("0") for word in words):
        return True
    if not all(map(listed.accepts, numbers)):
        return True
    if len(words) == 2:
        return listed.pair_most is not None and numbers[1] >= listed.pair_most
    return _ascends(decimals) and not _ascends(numbers)


def _ascends(values: list[float]) -> bool:
    return all(low < high for low, high in pairwise(values))
