"""References of follow-ups: one for all, or for each follow-up one with the same file stem."""

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Self

from acquisition.photographs import Inputs, Photograph, ReadOptions, each_image, read_photograph
from acquisition.printable import on_one_line
from analysis.followup_series import References
from analysis.sweep import SweepItem
from simulation.arrays import AnyArray
from standoff.errors import ApplicationError, ImageFileError
from standoff.library.swept_photographs import refusing


@dataclass(frozen=True, slots=True, kw_only=True)
class _PhotographReferences(References):
    """References and follow-ups that are read from image files, all in the way of ``reading``."""

    reading: ReadOptions

    @property
    def how_read(self) -> str:
        """The options of reading."""
        return str(self.reading)

    def followup(self, path: Path) -> Photograph:
        """Read a follow-up."""
        with refusing():
            return read_photograph(path, self.reading)


@dataclass(frozen=True, slots=True, kw_only=True)
class OneReference(_PhotographReferences):
    """The photograph that all follow-ups are compared with; every process reads it once.

    ``shape`` is ``(rows, cols)``; ``sha256`` must be the same for every process.
    """

    shape: tuple[int, ...]
    sha256: str

    @classmethod
    def read(cls, path: Path, inputs: Inputs) -> Self:
        """Read and list a reference.

        Raises
        ------
        ImageFileError
            If it cannot be read.
        """
        photograph = inputs.photograph(path)
        return cls(
            path=SweepItem.on_disk(path).path,
            name=on_one_line(path),
            reading=inputs.options,
            kinds=frozenset(photograph.remarks),
            shape=photograph.stored.shape[:2],
            sha256=photograph.sha256 or "",
        )

    def of(self, followup: Path) -> Photograph:
        """Return the one reference."""
        return _same_photograph(self)

    @property
    def shown_dn(self) -> AnyArray:
        """Levels of a picture of the one reference, grey or in colour."""
        return _same_photograph(self).shown_dn

    def name_for(self, followup: Path) -> None:
        """Return None: all follow-ups share one reference."""
        return

    def state_for(self, followup: Path) -> str:
        """Return an empty text: the hash of the reference is among the shared settings."""
        return ""


@lru_cache(maxsize=1)
def _same_photograph(reference: OneReference) -> Photograph:
    try:
        photograph = read_photograph(reference.path, reference.reading)
    except ImageFileError as error:
        # It was read at the start: no follow-up is at fault.
        raise ApplicationError(str(error)) from error
    if photograph.sha256 != reference.sha256:
        raise ApplicationError(f"{reference.name} has changed since the start")
    return photograph


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceFolder(_PhotographReferences):
    """A folder that holds, for each follow-up, a reference with the same file stem."""

    @classmethod
    def at(cls, folder: Path, reading: ReadOptions) -> Self:
        """Take a folder of references."""
        absolute = Path(os.path.abspath(folder))  # noqa: PTH100  resolve() follows links
        return cls(path=absolute, name=on_one_line(folder), reading=reading)

    def of(self, followup: Path) -> Photograph:
        """Read the reference of the follow-up's stem."""
        with refusing():
            return read_photograph(self._partner(followup), self.reading)

    def name_for(self, followup: Path) -> str:
        """Name the reference of the follow-up's stem."""
        return on_one_line(self._partner(followup))

    def state_for(self, followup: Path) -> str:
        """Return the reference's file name, size and time of change, as text."""
        return SweepItem.on_disk(self._partner(followup)).state

    def _partner(self, followup: Path) -> Path:
        found = _single_by_stem(self.path).get(followup.stem)
        if found is None:
            raise ImageFileError(f"{self.name}: the reference of {followup.name} has disappeared")
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class _PairedFolders:
    """Follow-ups with exactly one reference of the same stem, and photographs without a partner."""

    followups: tuple[Path, ...]
    unpaired: tuple[str, ...]


def pair_by_stem(references: Path, followups: Path) -> _PairedFolders:
    """Pair the photographs of two folders by stem; a stem that a folder has twice pairs nothing.

    Raises
    ------
    ApplicationError
        If a folder holds no image or cannot be read, or no photograph has a partner.
    """
    before, after = _by_stem(references), _by_stem(followups)
    paired = [
        stem for stem, own in after.items() if len(own) == 1 and len(before.get(stem, ())) == 1
    ]
    if not paired:
        raise ApplicationError(
            f"no photograph in {on_one_line(followups)} has the same name as one in "
            f"{on_one_line(references)}; names must agree except for the suffix"
        )
    is_paired = frozenset(paired)
    others = (
        path
        for found in (before, after)
        for stem, own in found.items()
        if stem not in is_paired
        for path in own
    )
    return _PairedFolders(
        followups=tuple(after[stem][0] for stem in paired),
        unpaired=tuple(sorted(map(on_one_line, others))),
    )


@lru_cache(maxsize=1)
def _single_by_stem(folder: Path) -> dict[str, Path]:
    return {stem: paths[0] for stem, paths in _by_stem(folder).items() if len(paths) == 1}


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {}
    for path in each_image([folder]):
        found.setdefault(path.stem, []).append(path)
    return found
