"""What changed between two picture files, beside what is written about it everywhere.

Pairs in which nothing changed, pairs with things, and, where ``STANDOFF_REAL_DATA`` names a folder
that holds ``null_pairs``, circuit boards with defects and a page from which a word was erased.
Peers: the difference of the files behind 1.5 px of smoothing, over 20 levels; SSIM with contours,
behind Otsu's threshold and behind .5; the difference behind a homography from SIFT's features.
Entries on nothing a pair, things found, and entries a thing that was found; a pair that a program
refuses has none of them.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.picture_peers
        [--null-pairs N] [--thing-pairs N] [--seed N]
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np

from benchmarks.harness import Recorder, benchmark, real_data
from benchmarks.peers.listers import LISTERS, OURS
from benchmarks.peers.program import Entry, PeerError
from benchmarks.scoring import Share
from benchmarks.studies.things import assigned
from benchmarks.truth.pictures import KINDS, Picture, catalogue, null_pairs
from benchmarks.truth.things import suitable, thing_pair

NULL_PAIRS, QUICK_NULL_PAIRS = 280, 28
THING_PAIRS, QUICK_THING_PAIRS = 60, 6
NOISE_KINDS = tuple(kind for kind in KINDS if kind.endswith(("-8", "-16")))
BOARDS = ("00041000", "00041018")
WORD = (191.0, 100.0, 24.0, 10.0)
"""Middle ``(x, y)``, width and height of what was erased from the page."""

_BOX_REACH_PX = 4.0

Owners = Callable[[Sequence[Entry]], list[int | None]]
"""Number of the thing that each entry is of; None if of nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Case:
    """Two files and what is between them."""

    name: str
    before: Path
    after: Path
    things: int
    owners: Owners


@dataclass(slots=True)
class _Tally:
    """What a program listed over pairs of a sort."""

    pairs: int = 0
    refused: int = 0
    pairs_with_false: int = 0
    on_nothing: int = 0
    things: int = 0
    entries: list[int] = field(default_factory=list)

    def add(self, case: _Case, entries: Sequence[Entry]) -> None:
        """Count a pair."""
        owners = case.owners(entries)
        false = owners.count(None)
        self.on_nothing += false
        self.pairs_with_false += false > 0
        counts = [owners.count(number) for number in range(case.things)]
        self.entries += [count for count in counts if count]


def _nothing(entries: Sequence[Entry]) -> list[int | None]:
    """No entry is of anything."""
    return [None] * len(entries)


def _in_boxes(boxes: Sequence[tuple[float, float, float, float]]) -> Owners:
    """Owners by boxes ``(left, top, right, bottom)`` in follow-up px, and 4 px around them."""

    def owners(entries: Sequence[Entry]) -> list[int | None]:
        reach = _BOX_REACH_PX
        return [
            next(
                (
                    number
                    for number, (left, top, right, bottom) in enumerate(boxes)
                    if left - reach <= entry.x_px <= right + reach
                    and top - reach <= entry.y_px <= bottom + reach
                ),
                None,
            )
            for entry in entries
        ]

    return owners


def _null_cases(
    pictures: Sequence[Picture], count: int, seed: int, folder: Path
) -> Iterator[_Case]:
    """Files of the same levels, and of the same scene with noise."""
    for pair in null_pairs(pictures, KINDS, count, seed):
        made = pair.make(folder)
        name = "nothing changed, noise" if pair.kind in NOISE_KINDS else "nothing changed, copies"
        yield _Case(name=name, before=made.before, after=made.after, things=0, owners=_nothing)


def _thing_cases(
    pictures: Sequence[Picture], count: int, seed: int, folder: Path
) -> Iterator[_Case]:
    """Things in photographs."""
    for number in range(count):
        pair = thing_pair(pictures, number, seed, folder)
        yield _Case(
            name="things, one pose" if pair.pose is None else "things, another pose",
            before=pair.before,
            after=pair.after,
            things=len(pair.things),
            owners=partial(assigned, pair),
        )


def _real_cases(folder: Path) -> Iterator[_Case]:
    """Boards with boxes of their defects, and the page."""
    for board in BOARDS:
        lines = (folder / f"{board}.txt").read_text("utf-8").split("\n")
        rows = [tuple(float(word) for word in line.split()[:4]) for line in lines if line.strip()]
        boxes = [(left, top, right, bottom) for left, top, right, bottom in rows]
        yield _Case(
            name="circuit boards, two levels",
            before=folder / f"{board}_temp.jpg",
            after=folder / f"{board}_test.jpg",
            things=len(boxes),
            owners=_in_boxes(boxes),
        )
    x, y, wide, high = WORD
    yield _Case(
        name="page, a word erased",
        before=folder / "half_a.png",
        after=folder / "half_chg.png",
        things=1,
        owners=_in_boxes([(x - wide / 2, y - high / 2, x + wide / 2, y + high / 2)]),
    )


def _count_case(tallies: dict[str, dict[str, _Tally]], case: _Case) -> None:
    """Let all programs list what changed in a pair."""
    for name, lister in LISTERS.items():
        tally = tallies.setdefault(case.name, {}).setdefault(name, _Tally())
        tally.pairs += 1
        tally.things += case.things
        try:
            entries = lister(case.before, case.after)
        except PeerError:
            tally.refused += 1
            continue
        tally.add(case, entries)


def _tell(record: Recorder, tallies: dict[str, dict[str, _Tally]]) -> None:
    """Say the table and keep its figures."""
    record.say(
        f"\n{'':28s} {'pairs':>5s} {'refused':>7s} {'on nothing, a pair':>18s} "
        f"{'pairs with any, %':>20s}  {'things':>6s} {'found, %':>20s} {'entries a thing':>15s}"
    )
    for sort, of_sort in tallies.items():
        record.say(sort)
        on_nothing, missed, entries = dict[str, float](), dict[str, float](), dict[str, float]()
        for name, tally in of_sort.items():
            compared = tally.pairs - tally.refused
            on_nothing[name] = tally.on_nothing / max(compared, 1)
            any_false = Share.of(tally.pairs_with_false, compared)
            found = Share.of(len(tally.entries), tally.things)
            missed[name] = 100 - found.percent
            entries[name] = float(np.mean(tally.entries)) if tally.entries else float("nan")
            things = f"{found!s:>20s} {entries[name]:15.2f}" if tally.things else ""
            record.say(
                f"  {name:26s} {tally.pairs:5d} {tally.refused:7d} {on_nothing[name]:18.2f} "
                f"{any_false!s:>20s}  {tally.things:6d} {things}"
            )
        _figures(record, sort, "entries on nothing, a pair", "1", on_nothing)
        if of_sort[OURS].things:
            _figures(record, sort, "missed", "%", missed)
            _figures(record, sort, "entries a thing", "1", entries)


def _figures(record: Recorder, sort: str, name: str, unit: str, values: dict[str, float]) -> None:
    if np.isnan(values[OURS]):
        return
    for peer, value in values.items():
        if peer != OURS:
            record.figure(
                f"{sort}: {name}", values[OURS], unit, peer, None if np.isnan(value) else value
            )


@benchmark("numpy", "scipy", "numba", "opencv-contrib-python-headless", "scikit-image")
def main(
    record: Recorder,
    *,
    null_pairs: Annotated[int | None, f"{NULL_PAIRS} by default"] = None,
    thing_pairs: Annotated[int | None, f"{THING_PAIRS} by default"] = None,
    seed: int = 1,
) -> None:
    with TemporaryDirectory() as made_in:
        folder = Path(made_in)
        shelf = catalogue()
        for reason in shelf.left_out:
            record.say(f"left out, {reason}")
        tallies = dict[str, dict[str, _Tally]]()
        nulls = record.pick(NULL_PAIRS, QUICK_NULL_PAIRS) if null_pairs is None else null_pairs
        for case in _null_cases(shelf.pictures, nulls, seed, folder):
            _count_case(tallies, case)
        things = record.pick(THING_PAIRS, QUICK_THING_PAIRS) if thing_pairs is None else thing_pairs
        for case in _thing_cases(suitable(shelf.pictures), things, seed, folder):
            _count_case(tallies, case)
        boards = real_data("null_pairs")
        if boards is None:
            record.say("STANDOFF_REAL_DATA does not name a folder with null_pairs: no boards")
        else:
            for case in _real_cases(boards):
                _count_case(tallies, case)
        _tell(record, tallies)
