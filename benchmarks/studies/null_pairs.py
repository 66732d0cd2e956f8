"""Pairs of pictures in which nothing changed: what the comparison says of them all the same.

Pictures that nobody of this project drew, as two files of the same levels, and twice with noise
(``benchmarks/truth/pictures.py``). They go through files and ``standoff.find_changes``. A row of a
table: how many pairs have any entry, entries and changed pixels a frame beside those that the
comparison states, light further than 3 errors from 1 (without an error: .01), blur further than 3
errors from 0, and how often it is said that both are as sharp. Intervals are 95 %: Wilson's for
shares; for pixels, pictures drawn anew with all their pairs.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.null_pairs [--pairs N]
        [--seed N] [--workers N] [--kind KIND]... [--picture NAME]... [--rows FILE]

``--only N --kind KIND --picture NAME --keep FOLDER`` makes one pair again and keeps its files.
"""

import re
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np

import standoff
from analysis.changes import describe_focus
from benchmarks.harness import Recorder, benchmark, outcomes, written
from benchmarks.scoring import Share
from benchmarks.truth.pictures import KINDS, NullPair, catalogue, null_pairs
from standoff.errors import REPORTED_ERRORS

PAIRS, QUICK_PAIRS = 2000, 56
WORST = 15
ERRORS = 3.0
GAIN_OFF = 0.01
"""Where no error of the gain is stated."""

_DRAWS = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """What was said of a pair; figures are NaN where the comparison was refused."""

    number: int
    seed: int
    kind: str
    picture: str
    genre: str
    recipe: str = ""
    is_as_sharp: bool = True
    true_gain: float = 1.0
    refused: str = ""
    crashed: bool = False
    changes: int = 0
    moved: int = 0
    changed_px: float = nan
    moved_px: float = nan
    compared_px: float = nan
    stated_px: float = nan
    gain: float = nan
    gain_err: float = nan
    extra_blur_px2: float = nan
    extra_blur_err_px2: float = nan
    noise_factor: float = nan
    focus: str = ""
    warnings: int = 0
    seconds: float = nan

    @property
    def entries(self) -> int:
        """Listed changes and movements."""
        return self.changes + self.moved

    @property
    def false_px(self) -> float:
        """Pixels of both."""
        return self.changed_px + self.moved_px

    @property
    def is_gain_off(self) -> bool:
        """Whether the light is said to differ, be the levels stored or of white."""
        relative_err = self.gain_err / self.gain
        has_error = isfinite(relative_err) and relative_err > 0
        off = min(abs(self.gain / truth - 1) for truth in (1.0, self.true_gain))
        return off > (ERRORS * relative_err if has_error else GAIN_OFF)

    @property
    def is_blur_off(self) -> bool:
        """Whether one is said to be sharper; an infinite or no error says nothing."""
        err_px2 = self.extra_blur_err_px2
        return isfinite(err_px2) and abs(self.extra_blur_px2) > ERRORS * err_px2

    @property
    def says_as_sharp(self) -> bool:
        """Whether the sentence on focus says so."""
        return "as sharp" in self.focus

    @property
    def command(self) -> str:
        """Options that make it again."""
        return (
            f"--seed {self.seed} --only {self.number} --kind {self.kind} --picture {self.picture}"
        )


def _head(pair: NullPair) -> _Row:
    picture = pair.picture
    return _Row(
        number=pair.number,
        seed=pair.seed,
        kind=pair.kind,
        picture=picture.name,
        genre=picture.genre,
    )


def _row_of(pair: NullPair, keep: Path | None) -> _Row:
    """Make a pair, compare its files, and note what is said."""
    with TemporaryDirectory() as made_in, warnings.catch_warnings():
        made = pair.make(keep or Path(made_in))
        head = replace(
            _head(pair), recipe=made.recipe, is_as_sharp=made.is_as_sharp, true_gain=made.gain
        )
        warnings.simplefilter("ignore")
        began_s = time.perf_counter()
        try:
            summary = standoff.find_changes(made.before, made.after).summary
        except REPORTED_ERRORS as error:
            seconds = time.perf_counter() - began_s
            return replace(head, refused=" ".join(str(error).split()), seconds=seconds)
        return replace(
            head,
            changes=len(summary.changes),
            moved=len(summary.moved),
            changed_px=float(summary.changed_px),
            moved_px=float(summary.moved_px),
            compared_px=float(summary.compared_px),
            stated_px=summary.false_alarms_px,
            gain=summary.gain,
            gain_err=float(getattr(summary, "gain_err", None) or nan),
            extra_blur_px2=summary.extra_blur_px2,
            extra_blur_err_px2=summary.extra_blur_err_px2,
            noise_factor=summary.noise_factor,
            focus=describe_focus(summary) or "",
            warnings=len(summary.warnings),
            seconds=time.perf_counter() - began_s,
        )


def _rows_of(pairs: Sequence[NullPair], workers: int, keep: Path | None) -> Iterator[_Row]:
    """Rows in the pairs' order; what nobody foresaw is a row as well, and said on stderr."""
    for pair, outcome in outcomes(partial(_row_of, keep=keep), pairs, workers):
        if isinstance(outcome, _Row):
            yield outcome
            continue
        print(f"{pair.command}: {outcome!r}", file=sys.stderr, flush=True)
        refused = f"{type(outcome).__name__}: {outcome}"
        yield replace(_head(pair), refused=refused, crashed=True)


def _mean_px(rows: Sequence[_Row]) -> tuple[float, float, float]:
    """Mean false pixels a frame and its interval, by drawing pictures with all their pairs."""
    of_picture: dict[str, list[float]] = {}
    for row in rows:
        of_picture.setdefault(row.picture, []).append(row.false_px)
    sums = np.array([[sum(values), len(values)] for values in of_picture.values()])
    rng = np.random.default_rng(0)
    drawn = sums[rng.integers(len(sums), size=(_DRAWS, len(sums)))].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], (2.5, 97.5))
    total, count = sums.sum(axis=0)
    return float(total / count), float(low), float(high)


HEAD = (
    f"{'':18s} {'pairs':>6s} {'refused':>7s}  {'any entry, %':>20s} {'entries':>8s}  "
    f"{'false px a frame':>26s} {'stated':>6s}  {'light off, %':>20s}  {'blur off, %':>20s}  "
    f"{'as sharp, %':>20s}"
)


def _line(record: Recorder, name: str, rows: Sequence[_Row]) -> None:
    """Say a row of a table and keep its figures."""
    known = [row for row in rows if not row.refused]
    refused = len(rows) - len(known)
    if not known:
        record.say(f"{name:18s} {len(rows):6d} {refused:7d}")
        return
    sharp = [row for row in known if row.is_as_sharp]
    any_entry = Share.of(sum(row.entries > 0 for row in known), len(known))
    lit = [row for row in known if isfinite(row.true_gain)]
    gain_off = Share.of(sum(row.is_gain_off for row in lit), len(lit))
    blur_off = Share.of(sum(row.is_blur_off for row in sharp), len(sharp))
    as_sharp = Share.of(sum(row.says_as_sharp for row in sharp), len(sharp))
    entries = float(np.mean([row.entries for row in known]))
    stated = float(np.mean([row.stated_px for row in known]))
    mean, low, high = _mean_px(known)
    record.say(
        f"{name:18s} {len(rows):6d} {refused:7d}  {any_entry!s:>20s} {entries:8.2f}  "
        f"{f'{mean:.1f} [{low:.1f}, {high:.1f}]':>26s} {stated:6.2f}  {gain_off!s:>20s}  "
        f"{blur_off!s:>20s}  {as_sharp!s:>20s}"
    )
    record.figure(f"pairs with an entry, {name}", any_entry.percent, "%")
    record.figure(f"false pixels a frame, {name}", mean, "px", "as stated", stated)
    if lit:
        record.figure(f"light said to differ, {name}", gain_off.percent, "%")
    if sharp:
        record.figure(f"sharpness said to differ, {name}", blur_off.percent, "%")
        record.figure(f"not said to be as sharp, {name}", 100 - as_sharp.percent, "%")


def _tell(record: Recorder, rows: Sequence[_Row]) -> None:
    """Say the tables: pooled, by kind, by genre; refusals; the worst pairs."""
    record.say(f"\n{HEAD}")
    _line(record, "all", rows)
    for kind in KINDS:
        if of_kind := [row for row in rows if row.kind == kind]:
            _line(record, kind, of_kind)
    record.say()
    for genre in sorted({row.genre for row in rows}):
        _line(record, f"all, {genre}", [row for row in rows if row.genre == genre])
    if seconds := [row.seconds for row in rows if isfinite(row.seconds)]:
        record.say(f"\n{np.median(seconds):.2f} s a pair, {max(seconds):.1f} s at most")
    refusals = Counter(_without_names(row.refused) for row in rows if row.refused)
    for text, count in refusals.most_common():
        record.say(f"refused {count} times: {text}")
    if crashed := sum(row.crashed for row in rows):
        record.say(f"{crashed} pairs ended in an error that is no refusal")
    record.say(f"\nthe worst {WORST}")
    bad = [row for row in rows if row.crashed or row.entries]
    bad.sort(
        key=lambda row: (row.crashed, row.entries, row.false_px if isfinite(row.false_px) else 0.0),
        reverse=True,
    )
    for row in bad[:WORST]:
        sign = " ".join(
            part
            for part, is_so in (
                (f"light x {row.gain:.4f}", row.is_gain_off and isfinite(row.true_gain)),
                (
                    f"blur {row.extra_blur_px2:+.3f} +- {row.extra_blur_err_px2:.3f} px^2",
                    row.is_blur_off and row.is_as_sharp,
                ),
            )
            if is_so
        )
        record.say(
            f"  {row.changes} + {row.moved} entries, {row.false_px:.0f} px {sign}\n"
            f"    {row.recipe}\n    {row.command}"
        )


def _without_names(text: str) -> str:
    """The message without the file's name before it and without its numbers."""
    is_named = text.startswith(("before.", "after.", "/"))
    return re.sub(r"\d+(\.\d+)?", "#", text.partition(": ")[2] if is_named else text)


@benchmark("numpy", "scipy", "numba", "Pillow", "scikit-image")
def main(
    record: Recorder,
    *,
    pairs: Annotated[int | None, f"{PAIRS} by default"] = None,
    seed: int = 1,
    workers: Annotated[int, "processes; 1"] = 1,
    kind: Annotated[list[str] | None, f"one of {KINDS}"] = None,
    picture: Annotated[list[str] | None, "a name, or a part of it"] = None,
    only: Annotated[list[int] | None, "these pairs alone"] = None,
    folder: Annotated[Path | None, "pictures of your own as well"] = None,
    rows: Annotated[Path | None, "each pair, CSV or JSON lines"] = None,
    keep: Annotated[Path | None, "keep the files of the last pair"] = None,
) -> None:
    shelf = catalogue(folder)
    pictures = shelf.named(picture or [])
    if not pictures:
        sys.exit(f"no picture is named {', '.join(picture or [])}")
    record.say(f"{len(pictures)} pictures: {', '.join(one.name for one in pictures)}")
    for reason in shelf.left_out:
        record.say(f"left out, {reason}")
    count = max(only) + 1 if only else pairs or record.pick(PAIRS, QUICK_PAIRS)
    chosen = [
        pair
        for pair in null_pairs(pictures, kind or KINDS, count, seed)
        if not only or pair.number in only
    ]
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    _tell(record, list(written(_rows_of(chosen, workers, keep), _Row, rows)))
