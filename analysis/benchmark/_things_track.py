"""Scores the track of things: lists of what was done to things, entry by entry.

An entry belongs to the thing whose outline, where it was or where it is, is nearest to its place
and no further away than ``REACH_PX``; any other entry is false.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import distance_transform_edt

from analysis.benchmark._data_set import (
    BenchmarkData,
    GivenThings,
    ThingsTruth,
    TrueThings,
)
from analysis.benchmark._program_files import ProgramFiles
from analysis.benchmark.scores import (
    ANSWERED,
    Estimate,
    ScoreList,
    estimate,
    groups_of,
    scene_numbers,
    share,
    share_of_sums,
)
from simulation.arrays import FloatArray, IntArray

REACH_PX = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _JudgedThings:
    """What a program's list says of a pair.

    ``entries`` are how many belong to each thing, shape (things,); ``told`` are the things of which
    an entry says what happened, ``told_rightly`` those of which all that say it say it rightly.
    """

    truth: TrueThings
    is_answered: bool
    entries: IntArray = field(repr=False)
    false_entries: int = 0
    told: int = 0
    told_rightly: int = 0

    @property
    def found(self) -> int:
        """Things that an entry belongs to."""
        return int(np.count_nonzero(self.entries))


def score_things(data: BenchmarkData, files: ProgramFiles, program: str) -> ScoreList:
    """Score a program's lists.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of the program cannot be used.
    """
    truth = data.read("truth/things.json", ThingsTruth)
    given = files.things(truth.tasks)
    judged = [_judged(truth.tasks[name], given.get(name), data) for name in sorted(truth.tasks)]
    scores = ScoreList(program=program, track="things")
    for group, members in groups_of([(f"kind {one.truth.kind}",) for one in judged]):
        _score_pairs(scores, group, [judged[at] for at in members])
    return scores


def _judged(truth: TrueThings, given: GivenThings | None, data: BenchmarkData) -> _JudgedThings:
    entries = None if given is None else given.entries
    counts = np.zeros(len(truth.things), np.int64)
    if entries is None:
        return _JudgedThings(truth=truth, is_answered=False, entries=counts)
    if truth.labels is None:
        return _JudgedThings(
            truth=truth, is_answered=True, entries=counts, false_entries=len(entries)
        )
    labels = data.levels(truth.labels).astype(np.int64)
    words: list[list[str]] = [[] for _ in truth.things]
    owners = _owners(labels, np.array([(one.x_px, one.y_px) for one in entries], np.float64))
    for entry, owner in zip(entries, owners, strict=True):
        if 1 <= owner <= len(truth.things):
            counts[owner - 1] += 1
            words[owner - 1] += [] if entry.what is None else [entry.what]
    told = [(said, one.what) for said, one in zip(words, truth.things, strict=True) if said]
    return _JudgedThings(
        truth=truth,
        is_answered=True,
        entries=counts,
        false_entries=len(entries) - int(counts.sum()),
        told=len(told),
        told_rightly=sum(all(word == what for word in said) for said, what in told),
    )


def _owners(labels: IntArray, places: FloatArray) -> list[int]:
    """Number of the thing that each place (x, y) belongs to, 0 for none."""
    if not len(places):
        return []
    away, nearest = distance_transform_edt(labels == 0, return_indices=True)
    rows, cols = labels.shape
    at_x, at_y = np.rint(np.clip(places, -1, [cols, rows])).astype(np.int64).T
    inside = (at_x >= 0) & (at_x < cols) & (at_y >= 0) & (at_y < rows)
    at_x, at_y = np.where(inside, at_x, 0), np.where(inside, at_y, 0)
    owner = labels[nearest[0][at_y, at_x], nearest[1][at_y, at_x]]
    found: list[int] = np.where(inside & (away[at_y, at_x] <= REACH_PX), owner, 0).tolist()
    return found


def _score_pairs(scores: ScoreList, group: str, pairs: Sequence[_JudgedThings]) -> None:
    mirrored = [one for one in pairs if one.truth.mirrored]
    others = [one for one in pairs if not one.truth.mirrored]
    answered = [one for one in others if one.is_answered]

    def add_share(measure: str, of: Sequence[_JudgedThings], is_hit: list[bool]) -> None:
        found = share(is_hit, _scenes(of))
        scores.add(group, measure, found, sum(one.is_answered for one in of), len(of))

    def add_ratio(measure: str, sums: list[tuple[int, int]]) -> None:
        if sums:
            found = share_of_sums(np.array(sums, np.float64), _scenes(others))
            scores.add(group, measure, found, len(answered), len(others))

    add_share(ANSWERED, others, [one.is_answered for one in others])
    add_ratio("things_found", [(one.found, one.entries.size) for one in others])
    add_ratio("precision", [(one.found, one.found + one.false_entries) for one in others])
    add_ratio("told_rightly", [(one.told_rightly, one.told) for one in others])
    unchanged = [one for one in others if not one.truth.changed]
    silent = [one.is_answered and not one.false_entries for one in unchanged]
    add_share("unchanged_silent", unchanged, silent)
    add_share("mirrored_refused", mirrored, [not one.is_answered for one in mirrored])
    for measure, found in _of_lists(answered):
        scores.add(group, measure, found, len(answered), len(others))


def _of_lists(answered: Sequence[_JudgedThings]) -> Iterator[tuple[str, Estimate | None]]:
    """How many entries the lists have that are false, and how many for a thing that is found."""
    false = np.array([one.false_entries for one in answered], np.float64)
    yield "false_entries", estimate(false, _scenes(answered), np.mean)
    finders = [one for one in answered if one.found]
    sums = np.array([(one.entries.sum(), one.found) for one in finders], np.float64)
    yield "entries_a_thing", estimate(sums, _scenes(finders), _ratio)


def _scenes(pairs: Sequence[_JudgedThings]) -> IntArray:
    return scene_numbers([one.truth.scene for one in pairs])


def _ratio(sums: FloatArray) -> float:
    return float(sums[:, 0].sum() / sums[:, 1].sum())
