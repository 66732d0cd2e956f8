"""Shards: which photographs are done together, by their names alone, and what does them."""

import hashlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from math import ceil, log2
from pathlib import Path
from typing import Protocol, Self

from analysis.sweep.manifest import HASH_BITS, Manifest, SweepItem

GROUPS = 64
"""Groups that the shards of many photographs fall into; mergeable sums are kept for each."""

_GROUP_BITS = 6
_SHARD_IMAGES_MOST = 64
"""On average: what a kill costs a worker at most."""

_BLOCK_BITS = 4
"""Of 16 shards: their sums are one file, so that a sum takes a thousandth of its size an image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """Photographs that one worker does, and one commit makes durable.

    Parameters
    ----------
    number
        Leading bits of the hashes of its photographs' paths: the same, whatever else is in the
        sweep.
    bits
        How many bits; 64 where each photograph is a shard of its own, below 128 photographs.
    items
        In the order of the hashes.
    key
        Hash of the work's key and of the items.
    block_key
        Hash of the keys of the up to 16 shards of its block.
    """

    number: int
    bits: int
    items: tuple[SweepItem, ...]
    key: str
    block_key: str

    @property
    def group(self) -> int:
        """0 to 63: the shards of a group are a random sixty-fourth of the photographs."""
        return self.items[0].hash >> (HASH_BITS - _GROUP_BITS)

    @property
    def name(self) -> str:
        """Name for the files of its commit: another one for each way to cut a sweep."""
        if self.bits == HASH_BITS:
            return f"{self.number:016x}"
        return f"{self.number << (HASH_BITS - self.bits):016x}-{self.bits}"

    def others(self, names: Iterable[str]) -> list[str]:
        """Those of the names of shards that share hashes with this one, cut in another way."""
        return [name for name in names if name != self.name and _overlap(name, self.name)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardDone:
    """What a shard gave.

    Parameters
    ----------
    images
        Photographs that gave something.
    refused
        A line for each photograph that gave nothing, that names it and says why.
    notes
        What is worth saying once in a sweep, by kind: how a kind of file was read.
    found_done
        Photographs among all of them that were taken from earlier commits.
    """

    images: int
    refused: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    found_done: int = 0

    @classmethod
    def of(cls, photographs: Iterable[tuple[str | None, Mapping[str, str]]]) -> Self:
        """Count photographs, each with why it gave nothing, or None, and its notes."""
        refused: list[str] = []
        notes: dict[str, str] = {}
        images = 0
        for refusal, own in photographs:
            notes |= {kind: min(text, notes.get(kind, text)) for kind, text in own.items()}
            if refusal is None:
                images += 1
            else:
                refused.append(refusal)
        return cls(images=images, refused=tuple(refused), notes=notes)


Finder = Callable[[Shard], tuple[ShardDone | None, Shard | None]]
"""Finds what earlier runs did of a shard, and the part of it that is left to do."""


class ShardWork(Protocol):
    """Does shards, in any process: it is pickled. A class derives from this.

    A commit is one durable write, which a kill leaves whole or undone. The same shard must give
    the same bits wherever and whenever it is done.

    A folder of pairs is swept by one photograph of each, such as the follow-up: the work finds
    the other by its name, and takes the size and time of what it finds into its key if it may
    change. A detector of one's own over thousands of pairs is such a work; its mergeable sums are
    the histograms of its scores.
    """

    @property
    def key(self) -> str:
        """Settings as text: what was done with others is not found."""
        ...

    @property
    def state(self) -> Path:
        """Absolute path of the folder of the commits, which exists and every worker sees."""
        ...

    def found(self, shard: Shard) -> ShardDone | None:
        """What an earlier run committed for these very photographs; called in the client."""
        ...

    def __call__(self, shard: Shard) -> ShardDone:
        """Do the shard and commit it. A photograph that gives nothing is refused, not raised."""
        ...

    def finder(self, manifest: Manifest) -> Finder:
        """Look for what earlier runs did; called in the client. By default it is whole shards."""

        def find(shard: Shard) -> tuple[ShardDone | None, Shard | None]:
            done = self.found(shard)
            return done, (shard if done is None else None)

        return find

    def commit_block(self, shards: Sequence[Shard], fresh: Sequence[Shard]) -> None:
        """Take note of a block all of whose shards are done; called in the client.

        ``fresh`` are those that this run did, with what was left to do.
        """
        return


@dataclass(frozen=True, slots=True)
class Layout:
    """How many leading bits of the hash make a shard, and how many a block of shards."""

    shard_bits: int
    block_bits: int

    @classmethod
    def of(cls, images: int) -> "Layout":
        """Layout for so many photographs: about 64 shards, more where these were too large."""
        if is_few(images):
            return cls(HASH_BITS, HASH_BITS)
        size = min(2 ** round(log2(images // GROUPS)), _SHARD_IMAGES_MOST)
        bits = ceil(log2(images / size))
        return cls(bits, max(bits - _BLOCK_BITS, _GROUP_BITS))


def is_few(images: int) -> bool:
    """Whether each of so many photographs is a shard, and a group, of its own."""
    return images < 2 * GROUPS


def blocks_of(
    manifest: Manifest, work_key: str, part: tuple[int, int] = (1, 1)
) -> Iterator[tuple[Shard, ...]]:
    """Yield the shards of a sweep block by block, in the order of their numbers.

    Parameters
    ----------
    manifest
        The photographs.
    work_key
        What is done with them.
    part
        ``(k, n)``: the k-th of n parts of about equally many photographs. No block is in two.
    """
    layout = Layout.of(len(manifest))
    first = 0
    for _, run in groupby(manifest, lambda item: item.hash >> (HASH_BITS - layout.block_bits)):
        items = list(run)
        if first * part[1] // len(manifest) == part[0] - 1:
            yield _block(items, layout, work_key)
        first += len(items)


def _block(items: Sequence[SweepItem], layout: Layout, work_key: str) -> tuple[Shard, ...]:
    by_number = {
        number: tuple(run)
        for number, run in groupby(items, lambda item: item.hash >> (HASH_BITS - layout.shard_bits))
    }
    keys = {number: shard_key(run, work_key) for number, run in by_number.items()}
    block_key = _hash_of(keys.values())
    return tuple(
        Shard(
            number=number,
            bits=layout.shard_bits,
            items=run,
            key=keys[number],
            block_key=block_key,
        )
        for number, run in by_number.items()
    )


def shard_key(items: Sequence[SweepItem], work_key: str) -> str:
    """Hash of what is done with which photographs."""
    return _hash_of([work_key, *(item.state for item in items)])


def overlaps(names: Iterable[str], others: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield names of shards, each with those of other, sorted names that share hashes with it."""
    for name in names:
        last = _span(name)[1]
        before = max(bisect_right(others, name) - 1, 0)
        after = bisect_right(others, f"{last:016x}~")
        yield name, [one for one in others[before:after] if _overlap(one, name)]


def _overlap(one: str, other: str) -> bool:
    (first, last), (other_first, other_last) = _span(one), _span(other)
    return max(first, other_first) <= min(last, other_last)


def _span(name: str) -> tuple[int, int]:
    """The least and the largest hash of a shard, by its name; of another file's name none."""
    first, _, bits = name.partition("-")
    try:
        low = int(first, 16)
        return low, low + (1 << (HASH_BITS - int(bits or HASH_BITS))) - 1
    except ValueError:
        return 1, 0


def _hash_of(texts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()
