"""Which photographs of a sweep earlier commits hold, however those were cut into shards."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from analysis.sweep.manifest import Manifest, SweepItem

Digests = NDArray[np.uint64]

_ITEMS_AT_ONCE = 1000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class KeptItems:
    """Photographs of a sweep that usable commits hold, each in one: 12 bytes a photograph.

    Parameters
    ----------
    usable
        Numbers of the commits: those whose photographs are all in the sweep, and in no larger one.
    digests
        Of the photographs in them, increasing.
    commits
        The commit of each.
    """

    usable: tuple[int, ...]
    digests: Digests
    commits: NDArray[np.int32]

    @classmethod
    def of(cls, manifest: Manifest, commits: Sequence[Digests]) -> "KeptItems":
        """Compare the commits, each given by the digests of its photographs, with a sweep."""
        known = np.unique(np.concatenate([*commits, np.empty(0, np.uint64)]))
        is_there = np.zeros(len(known), np.bool_)
        items = iter(manifest)
        while len(known) and (some := list(islice(items, _ITEMS_AT_ONCE))):
            at, is_known = _places(known, digests_of(some))
            is_there[at[is_known]] = True
        usable: list[int] = []
        # From the largest on: a merge that was killed leaves its parts beside the whole.
        for number in sorted(range(len(commits)), key=lambda one: (-len(commits[one]), one)):
            at, _ = _places(known, commits[number])
            if is_there[at].all():
                usable.append(number)
                is_there[at] = False  # taken
        digests = np.concatenate([*(commits[one] for one in usable), np.empty(0, np.uint64)])
        order = np.argsort(digests)
        owners = np.repeat(np.array(usable, np.int32), [len(commits[one]) for one in usable])
        return cls(usable=tuple(usable), digests=digests[order], commits=owners[order])

    def __len__(self) -> int:
        return len(self.digests)

    def commits_of(self, items: Sequence[SweepItem]) -> list[int | None]:
        """Return the commit of each photograph; None for one that is left to do."""
        at, is_known = _places(self.digests, digests_of(items))
        return [
            int(self.commits[place]) if known else None
            for place, known in zip(at, is_known, strict=True)
        ]


def digests_of(items: Sequence[SweepItem]) -> Digests:
    """Digests of photographs as they were on disk."""
    return np.fromiter((item.digest for item in items), np.uint64, len(items))


def _places(known: Digests, wanted: Digests) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    if len(known) == 0:
        return np.zeros(len(wanted), np.intp), np.zeros(len(wanted), np.bool_)
    at = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    return at, known[at] == wanted
