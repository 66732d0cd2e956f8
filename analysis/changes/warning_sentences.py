"""What makes changes doubtful, in sentences."""

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.changes.document import Change
from simulation.arrays import BoolArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeMasks:
    """Masks on the follow-up's pixels, shape ``(rows, cols)`` each.

    Parameters
    ----------
    is_change
        Pixels beyond the threshold.
    valid
        Pixels that were compared.
    clipped
        Pixels at which the follow-up is clipped.
    reference_clipped
        Pixels at which the reference is, as the follow-up would see it.
    """

    is_change: BoolArray
    valid: BoolArray
    clipped: BoolArray
    reference_clipped: BoolArray


def change_warnings(changes: Sequence[Change], masks: ChangeMasks) -> tuple[str, ...]:
    """Return a sentence each for flagged borders, likely gloss and a small overlap."""
    raise NotImplementedError
