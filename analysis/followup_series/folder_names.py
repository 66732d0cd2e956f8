"""Names of the folders for the results of many photographs: the same for any order of them."""

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from acquisition.printable import beginning_of
from analysis.sweep import Manifest

_HASH_DIGITS = 12
_LONGEST_STEM_BYTES = 200
"""Before a hash; a name has 255 at most."""


@dataclass(frozen=True, slots=True)
class FolderNames:
    """A photograph's folder is named by its stem, or by stem and path where the stem is taken.

    The same where a letter of the stem is not printable, which no document and no page may hold.

    ``taken`` holds the hashes of stems that several photographs have, or that are not to be used.
    Whether a file system tells capitals from small letters does not matter.
    """

    taken: frozenset[int]

    @classmethod
    def of(cls, photographs: Manifest, reserved: Iterable[str]) -> Self:
        """Find the stems that several photographs have; ``reserved`` are names of other files."""
        stems = (_hash(item.path.stem) for item in photographs)
        hashes = np.fromiter(stems, dtype=np.uint64, count=len(photographs))
        values, counts = np.unique(hashes, return_counts=True)
        # pathlib takes the stem of "...tif" for "..".
        unusable = {_hash(name) for name in (".", "..", *reserved)}
        return cls(frozenset(values[counts > 1].tolist()) | unusable)

    def name_of(self, path: Path) -> str:
        """Return the name of the folder for a photograph's results."""
        stem = path.stem
        if stem.isprintable() and _hash(stem) not in self.taken:
            return stem
        shown = "".join(letter if letter.isprintable() else "_" for letter in stem)
        digest = hashlib.sha256(os.fsencode(path)).hexdigest()
        return f"{beginning_of(shown, _LONGEST_STEM_BYTES)}-{digest[:_HASH_DIGITS]}"


def _hash(name: str) -> int:
    return int.from_bytes(hashlib.sha256(os.fsencode(name.casefold())).digest()[:8], "big")
