"""Lists of numbers on the command line, where commas separate and a decimal comma is a slip."""

import math
import re
from dataclasses import dataclass

from typer import BadParameter

from acquisition.quantities import decimals_meant
from standoff.terminal.output import note


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedNumbers:
    """What the numbers of an option may be: from ``least`` (-inf for any), or above 0.

    Of two whole numbers, the second is probably a decimal if it is ``pair_most`` or more.
    """

    option: str
    least: float | None = None
    pair_most: float | None = None

    @property
    def bound(self) -> str:
        """The bound in words."""
        if self.least == -math.inf:
            return "that are finite"
        return "above 0" if self.least is None else f"of at least {self.least:g}"

    def accepts(self, value: float) -> bool:
        """Whether a value is finite and within the bound."""
        is_within = value > 0 if self.least is None else value >= self.least
        return math.isfinite(value) and is_within


def number_list(text: str, listed: ListedNumbers) -> list[float]:
    """Read numbers separated by commas, each once, in the order in which they are written."""
    meant = decimals_meant(text, listed.accepts, listed.pair_most)
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
