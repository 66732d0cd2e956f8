"""Things taken out of photographs, added to them, and moved: what the comparison lists.

Things of 5 to 60 px in photographs that nobody of this project took, three to a pair, on plain,
textured and repeating ground, from one pose or from two (``benchmarks/truth/things.py``). An entry
is a thing's if its place is inside the thing's outline, or within 4 px or .3 of its size of it; of
what moved, at either place. Wanted: at most 2 % of what was removed or added is called moved, at
least 85 % of what moved is, and none of it is missed; at most 1.3 entries a thing that was found.
What is fainter than 10 levels is not made.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.things [--things N]
        [--seed N] [--workers N] [--rows FILE]

``--only N --keep FOLDER`` makes one pair again and keeps its files, with outlines drawn on them.
"""

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import ceil, hypot, isfinite, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
import numpy as np
from scipy.ndimage import binary_dilation

from benchmarks.harness import Recorder, benchmark, outcomes, written
from benchmarks.peers.listers import standoff_changes
from benchmarks.peers.program import Entry, PeerError
from benchmarks.scoring import Share
from benchmarks.truth.pictures import Picture, catalogue
from benchmarks.truth.things import (
    GROUNDS,
    HAPPENINGS,
    THINGS,
    Thing,
    ThingPair,
    shift_in_followup,
    suitable,
    thing_pair,
)

COUNT, QUICK_COUNT = 300, 18
CONTRASTS_DN = (10.0, 20.0, 40.0, 80.0, 256.0)
SIZES_PX = (0.0, 10.0, 20.0, 40.0, 90.0)
WORDS = {"removed": "gone", "added": "new", "moved": "moved"}
SHIFT_OFF_PX = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """A thing and what was listed of it; the first of a pair has what was listed on nothing."""

    number: int
    seed: int
    recipe: str = ""
    pose: str = ""
    happening: str = ""
    ground: str = ""
    way: str = ""
    size_px: float = nan
    contrast_dn: float = nan
    shift_px: float = nan
    x_px: float = nan
    y_px: float = nan
    refused: str = ""
    crashed: bool = False
    changes: int = 0
    moved: int = 0
    parts: int = 0
    said: int = 0
    said_right: int = 0
    shift_off_px: float = nan
    is_first: bool = False
    changes_on_nothing: int = 0
    moved_on_nothing: int = 0
    faint: int = 0
    seconds: float = nan

    @property
    def entries(self) -> int:
        """Of the thing."""
        return self.changes + self.moved


def assigned(pair: ThingPair, entries: Sequence[Entry]) -> list[int | None]:
    """Number of the thing that each entry is of; the nearest, None if of nothing."""
    owners = list[int | None]()
    for entry in entries:
        x, y = pair.in_reference(entry.x_px, entry.y_px)
        near = [number for number, thing in enumerate(pair.things) if thing.holds(x, y)]
        owners.append(
            min(near, key=lambda n: pair.things[n].distance_px[round(y), round(x)], default=None)
        )
    return owners


def _rows_of_pair(
    number: int, seed: int, pictures: Sequence[Picture], keep: Path | None
) -> list[_Row]:
    """Make a pair, compare its files, and note what is listed of each thing."""
    with TemporaryDirectory() as made_in:
        pair = thing_pair(pictures, number, seed, keep or Path(made_in))
        if keep is not None:
            _draw(pair, keep)
        began_s, refused = time.perf_counter(), ""
        entries: tuple[Entry, ...] = ()
        try:
            entries = standoff_changes(pair.before, pair.after)
        except PeerError as error:
            refused = str(error)
        seconds = time.perf_counter() - began_s
    owners = assigned(pair, entries)

    def entries_of(owner: int | None) -> list[Entry]:
        return [entry for entry, of in zip(entries, owners, strict=True) if of == owner]

    alone = entries_of(None)
    head = _Row(number=number, seed=seed, refused=refused, recipe=pair.recipe, seconds=seconds)
    rows = [_row(pair, thing, entries_of(n), head) for n, thing in enumerate(pair.things)]
    if rows:
        rows[0] = replace(
            rows[0],
            is_first=True,
            changes_on_nothing=sum(not one.is_moved for one in alone),
            moved_on_nothing=sum(one.is_moved for one in alone),
            faint=pair.faint,
        )
    return rows


def _row(pair: ThingPair, thing: Thing, own: Sequence[Entry], head: _Row) -> _Row:
    rows, cols = np.nonzero(thing.outlines)
    shifts = [entry.shift_px for entry in own if entry.shift_px is not None]
    off = nan
    if shifts and thing.happening == "moved":
        right, down = shift_in_followup(pair, thing)
        off = min(hypot(x - right, y - down) for x, y in shifts)
    words = ["moved" if entry.is_moved else entry.what for entry in own if entry.what is not None]
    return replace(
        head,
        pose="one pose" if pair.pose is None else "another pose",
        happening=thing.happening,
        ground=thing.ground,
        way=thing.way,
        size_px=thing.size_px,
        contrast_dn=thing.contrast_dn,
        shift_px=hypot(*thing.shift_px),
        x_px=float(cols.mean()),
        y_px=float(rows.mean()),
        changes=sum(not entry.is_moved for entry in own),
        moved=sum(entry.is_moved for entry in own),
        parts=sum(entry.parts for entry in own),
        said=len(words),
        said_right=words.count(WORDS[thing.happening]),
        shift_off_px=off,
    )


def _draw(pair: ThingPair, folder: Path) -> None:
    """Outlines, red, on the photograph before."""
    shown = cv2.imread(str(pair.before))
    assert shown is not None
    for thing in pair.things:
        shown[binary_dilation(thing.outlines, iterations=2) & ~thing.outlines] = (0, 0, 255)
    cv2.imwrite(str(folder / "outlines.png"), shown)


def _crashed(number: int, seed: int, error: BaseException) -> _Row:
    """Row of an error that nobody foresaw, which is said on stderr."""
    print(f"--seed {seed} --only {number}: {error!r}", file=sys.stderr, flush=True)
    refused = f"{type(error).__name__}: {error}"
    return _Row(number=number, seed=seed, refused=refused, crashed=True)


def _tell(record: Recorder, rows: Sequence[_Row]) -> None:
    """Say the tables and keep the figures."""
    known = [row for row in rows if not row.refused]
    pairs = [row for row in known if row.is_first]
    record.say(
        f"{len(rows)} things in {len({row.number for row in rows})} pairs, {len(known)} in "
        f"{len(pairs)} pairs that were compared; {sum(row.faint for row in rows)} were too faint "
        "or found no room"
    )
    for text, count in Counter(row.refused for row in rows if row.refused).most_common():
        record.say(f"  {count} things refused: {text}")
    record.say(
        f"\n{'':24s} {'things':>6s}  {'found, %':>20s}  {'as moved, %':>20s}  {'entries':>7s}  "
        f"{'right word, %':>20s}"
    )
    for happening in HAPPENINGS:
        _line(record, happening, [row for row in known if row.happening == happening])
    for name, part in _parts(known):
        for names, said in ((("removed", "added"), "in or out"), (("moved",), "moved")):
            if chosen := [row for row in part if row.happening in names]:
                _line(record, f"{name}, {said}", chosen, is_figure=False)
    _totals(record, known, pairs)
    _misses(record, known)


def _parts(rows: Sequence[_Row]) -> Iterator[tuple[str, list[_Row]]]:
    """Rows by ground, pose, contrast and size."""
    for ground in GROUNDS:
        yield ground, [row for row in rows if row.ground == ground]
    for pose in ("one pose", "another pose"):
        yield pose, [row for row in rows if row.pose == pose]
    for low, high in pairwise(CONTRASTS_DN):
        yield f"{low:.0f} to {high:.0f} DN", [row for row in rows if low <= row.contrast_dn < high]
    for low, high in pairwise(SIZES_PX):
        yield f"{low:.0f} to {high:.0f} px", [row for row in rows if low <= row.size_px < high]


def _line(record: Recorder, name: str, rows: Sequence[_Row], *, is_figure: bool = True) -> None:
    found = [row for row in rows if row.entries]
    share = Share.of(len(found), len(rows))
    moved = Share.of(sum(row.moved > 0 for row in rows), len(rows))
    entries = float(np.mean([row.entries for row in found])) if found else nan
    said = sum(row.said for row in rows)
    right = Share.of(sum(row.said_right for row in rows), said)
    record.say(
        f"{name:24s} {len(rows):6d}  {share!s:>20s}  {moved!s:>20s}  {entries:7.2f}  "
        f"{str(right) if said else '':>20s}"
    )
    if not is_figure or not rows:
        return
    record.figure(f"missed of what was {name}", 100 - share.percent, "%")
    wanted = 100 - moved.percent if name == "moved" else moved.percent
    word = "not called moved" if name == "moved" else "called moved"
    record.figure(f"{word} of what was {name}", wanted, "%")
    record.figure(f"entries a thing that was {name}", entries, "1")
    if said:
        record.figure(f"wrong words for what was {name}", 100 - right.percent, "%")


def _totals(record: Recorder, known: Sequence[_Row], pairs: Sequence[_Row]) -> None:
    found = [row.entries for row in known if row.entries]
    if not pairs or not found:
        return
    on_nothing = sum(row.changes_on_nothing + row.moved_on_nothing for row in pairs)
    moved = sum(row.moved_on_nothing for row in pairs)
    any_share = Share.of(
        sum(row.changes_on_nothing + row.moved_on_nothing > 0 for row in pairs), len(pairs)
    )
    record.say(
        f"\nentries a thing {np.mean(found):.2f}, wanted at most 1.3\n"
        f"entries on nothing: {on_nothing} in {len(pairs)} pairs, {moved} of them movements; pairs "
        f"with any {any_share} %"
    )
    record.figure("entries a thing", float(np.mean(found)), "1")
    record.figure("entries on nothing, a pair", on_nothing / len(pairs), "1")
    off = [row.shift_off_px for row in known if isfinite(row.shift_off_px)]
    if off:
        right = Share.of(sum(value < SHIFT_OFF_PX for value in off), len(off))
        record.say(
            f"shifts of what moved: {right} % of {len(off)} right to {SHIFT_OFF_PX:g} px, median "
            f"error {np.median(off):.2f} px"
        )
        record.figure(f"shifts off by more than {SHIFT_OFF_PX:g} px", 100 - right.percent, "%")
    seconds = [row.seconds for row in pairs]
    record.say(f"{np.median(seconds):.2f} s a pair, {max(seconds):.1f} s at most")


def _misses(record: Recorder, known: Sequence[_Row]) -> None:
    """Name what went wrong, and how to make it again."""
    wrong = [
        (word, row)
        for row in known
        for word, is_so in (
            ("missed", row.entries == 0),
            ("called moved", row.happening != "moved" and row.moved > 0),
            ("not called moved", row.happening == "moved" and row.entries > 0 and row.moved == 0),
            (f"{row.entries} entries", row.entries > 4),
            (
                f"{row.changes_on_nothing} + {row.moved_on_nothing} on nothing, beside",
                row.changes_on_nothing + row.moved_on_nothing > 4,
            ),
        )
        if is_so
    ]
    record.say("\nwhat went wrong")
    for word, row in wrong:
        shift = f", {row.shift_px:.0f} px" if isfinite(row.shift_px) else ""
        record.say(
            f"  {word}: {row.happening}{shift}, {row.size_px:.0f} px, {row.contrast_dn:.0f} DN at "
            f"({row.x_px:.0f}, {row.y_px:.0f}), {row.way}\n    {row.recipe}\n"
            f"    --seed {row.seed} --only {row.number}"
        )


@benchmark("numpy", "scipy", "numba", "opencv-contrib-python-headless", "scikit-image")
def main(
    record: Recorder,
    *,
    things: Annotated[int | None, f"{COUNT} by default"] = None,
    seed: int = 1,
    workers: Annotated[int, "processes; 1"] = 1,
    only: Annotated[list[int] | None, "these pairs alone"] = None,
    rows: Annotated[Path | None, "each thing, CSV or JSON lines"] = None,
    keep: Annotated[Path | None, "keep the files of the last pair"] = None,
) -> None:
    shelf = catalogue()
    pictures = suitable(shelf.pictures)
    record.say(f"{len(pictures)} photographs: {', '.join(one.name for one in pictures)}")
    for reason in shelf.left_out:
        record.say(f"left out, {reason}")
    count = ceil((things or record.pick(COUNT, QUICK_COUNT)) / THINGS)
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    work = partial(_rows_of_pair, seed=seed, pictures=pictures, keep=keep)
    found = (
        row
        for number, outcome in outcomes(work, only or list(range(count)), workers)
        for row in (outcome if isinstance(outcome, list) else [_crashed(number, seed, outcome)])
    )
    _tell(record, list(written(found, _Row, rows)))
