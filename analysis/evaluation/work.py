"""Scores a detector on the pairs of photographs, shard by shard; one photograph can be resumed."""

import atexit
import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from time import monotonic

import numpy as np

from acquisition.printable import on_one_line
from acquisition.session import commit_file
from analysis.detectability import SceneImage
from analysis.detectors import CheckedDetector, DetectorSpec, open_detector
from analysis.errors import AnalysisError, DetectorError, RefusedPhotographError, SweepError
from analysis.evaluation.painted_changes import LaterScene
from analysis.evaluation.pairs import ChangePair, PairMaker
from analysis.evaluation.roc import MOST_MARKS as MARKS, marks_of
from analysis.evaluation.scores import (
    FailedPair,
    PhotographScores,
    read_photograph_scores,
    scores_bytes,
)
from analysis.evaluation.task import EvaluationTask
from analysis.sweep import Shard, ShardDone, ShardWork, refusal_line, shard_key
from simulation import Psf
from simulation.arrays import Float32Array

_SUFFIX, _PARTIAL = ".scores.npz", ".partial.npz"
_KEY_LETTERS = 16
_SAVED_EVERY_S = 20.0
_MOST_FAILURES = 25
"""Pairs without a score, one after the other and none before with one, that end the work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationWork(ShardWork):
    """Runs a detector on pairs and keeps its scores.

    Parameters
    ----------
    detector
        What is evaluated.
    task, psf
        What pairs are made, and the camera's total PSF.
    load
        Photograph of a file, or a RefusedPhotographError; a function that a worker can import.
    later
        Likewise the scene of that photograph as it was later; None to paint the task's change.
    reading
        How ``load`` reads, as text.
    folder
        Absolute path of the folder of the scores.
    timeout_s
        Longest time for one pair.
    is_strict
        Whether the first pair without a score ends the sweep.
    """

    detector: DetectorSpec
    task: EvaluationTask
    psf: Psf | None
    load: Callable[[Path], SceneImage]
    later: Callable[[Path], LaterScene] | None = None
    reading: str
    folder: Path
    timeout_s: float = 60.0
    is_strict: bool = False

    @property
    def key(self) -> str:
        """See `ShardWork.key`."""
        return self.task.key(self.psf, self.detector.identity, self.reading)

    @property
    def state(self) -> Path:
        """See `ShardWork.state`."""
        return self.folder

    def found(self, shard: Shard) -> ShardDone | None:
        """See `ShardWork.found`; a shard with pairs without a score is tried again."""
        stored = read_photograph_scores(self._file(shard), self._key(shard))
        if stored is None or any(one.failed for one in stored[0]):
            return None
        told = json.loads(str(stored[1]))
        return ShardDone(images=told["images"], refused=tuple(told["refused"]), notes=told["notes"])

    def __call__(self, shard: Shard) -> ShardDone:
        """See `ShardWork.__call__`."""
        photographs: list[PhotographScores] = []
        given: list[tuple[str | None, dict[str, str]]] = []
        found_done = 0
        for number, item in enumerate(shard.items):
            try:
                scene = self.load(item.path)
                maker = self._maker(scene, item.path)
                kept = self._kept(shard, number, item.path, scene, is_colour=maker.is_colour)
                found_done += bool(kept.is_done.all())
                self._complete(kept, maker, partial(self._save, shard, number))
                photographs.append(kept)
            except (RefusedPhotographError, ValueError) as error:
                given.append((refusal_line(item.path, str(error)), {}))
            else:
                given.append((None, dict(scene.notes)))
        done = ShardDone.of(given)
        told = {"images": done.images, "refused": done.refused, "notes": dict(done.notes)}
        content = scores_bytes(self._key(shard), photographs, json.dumps(told))
        commit_file(self._file(shard), content)
        for number in range(len(shard.items)):
            self._file(shard, number).unlink(missing_ok=True)
        return replace(done, found_done=found_done)

    def scores(self, shard: Shard) -> list[PhotographScores]:
        """Read what a finished shard gave.

        Raises
        ------
        AnalysisError
            If it is gone.
        """
        stored = read_photograph_scores(self._file(shard), self._key(shard))
        if stored is None:
            raise AnalysisError(
                f"{self._file(shard)} vanished or was damaged; run the same command again"
            )
        return stored[0]

    def drop_others(self, kept: set[Path]) -> None:
        """Delete scores of other photographs, settings and detectors."""
        for path in self.folder.iterdir():
            if path.name.endswith((_SUFFIX, _PARTIAL)) and path not in kept:
                path.unlink(missing_ok=True)

    def file_of(self, shard: Shard) -> Path:
        """Where the scores of a shard are kept."""
        return self._file(shard)

    def _key(self, shard: Shard) -> str:
        return f"{self._settings_hash} {shard.key}"

    @property
    def _settings_hash(self) -> str:
        return shard_key((), self.key)

    @property
    def _suffix(self) -> str:
        return f".{self._settings_hash[:_KEY_LETTERS]}{_SUFFIX}"

    def _file(self, shard: Shard, photograph: int | None = None) -> Path:
        name = f"{shard.name}{self._suffix}"
        if photograph is not None:
            name = name.removesuffix(_SUFFIX) + f"-{photograph}{_PARTIAL}"
        return self.folder / name

    def _save(self, shard: Shard, photograph: int, kept: PhotographScores) -> None:
        commit_file(self._file(shard, photograph), scores_bytes(self._key(shard), [kept], ""))

    def _maker(self, scene: SceneImage, path: Path) -> PairMaker:
        """Makes the pairs of a photograph: in colour if it is, and the detector takes colours."""
        later = None if self.later is None else self.later(path)
        levels_dn = scene.grey_dn
        colours = scene.colours if later is None or later.after_dn.ndim == 3 else None
        if colours is not None and self._own_detector.detector.takes_colour:
            levels_dn = colours()
        if later is not None and levels_dn.ndim == 2:
            later = later.in_grey
        return PairMaker(
            levels_dn=levels_dn, digest=scene.sha256, task=self.task, psf=self.psf, later=later
        )

    @property
    def _own_detector(self) -> "_Opened":
        return _opened(self.detector, self.timeout_s)

    def _kept(
        self, shard: Shard, photograph: int, path: Path, scene: SceneImage, *, is_colour: bool
    ) -> PhotographScores:
        """Scores that an earlier run gave, however it was cut; failed pairs are tried again."""
        names = (file.name.partition(".")[0] for file in self.folder.glob(f"*{self._suffix}"))
        others = (self.folder / f"{name}{self._suffix}" for name in shard.others(names))
        for file in (self._file(shard, photograph), self._file(shard), *others):
            stored = read_photograph_scores(file, self._settings_hash)
            for one in () if stored is None else stored[0]:
                if one.sha256 == scene.sha256 and one.path == on_one_line(path):
                    one.failed.clear()
                    np.logical_and(one.is_done, np.isfinite(one.scores).all(-1), out=one.is_done)
                    return one
        shape = self.task.crops, len(self.task.conditions)
        empty = PhotographScores.empty(on_one_line(path), scene.sha256, scene.encoding, shape)
        return replace(empty, is_colour=is_colour)

    def _complete(
        self,
        kept: PhotographScores,
        maker: PairMaker,
        save: Callable[[PhotographScores], None],
    ) -> None:
        """Score the pairs that no earlier run has scored."""
        judge = _Judge(work=self, opened=self._own_detector, kept=kept)
        saved_s = monotonic()
        try:
            for crop, number in zip(*np.nonzero(~kept.is_done), strict=True):
                tried = maker.pairs(int(crop), self.task.conditions[number])
                failed = [judge.failed(pair, int(number)) for pair in tried]
                kept.failed.extend(filter(None, failed))
                kept.is_done[crop, number] = True
                if monotonic() - saved_s > _SAVED_EVERY_S:
                    save(kept)
                    saved_s = monotonic()
        except BaseException:
            save(kept)
            raise


@dataclass(slots=True, kw_only=True)
class _Judge:
    """Runs the detector on pairs, and notes what it says."""

    work: EvaluationWork
    opened: "_Opened"
    kept: PhotographScores

    def failed(self, pair: ChangePair, number: int) -> FailedPair | None:
        """Note what the detector says of a pair; if it says nothing, return why."""
        at = pair.crop, number, int(pair.place is not None)
        try:
            answer = self.opened.detector(pair.reference, pair.followup, pair.homography)
        except DetectorError as error:
            return self._failed(pair, error)
        self.opened.has_answered = True
        self.kept.scores[at] = answer.score
        if answer.map is not None:
            self._mark(pair, number, answer.map)
        return None

    def _mark(self, pair: ChangePair, number: int, change_map: Float32Array) -> None:
        apart_px = max(self.work.task.change.radius_px / pair.condition.zoom, 1.0)
        marks = marks_of(change_map, MARKS, apart_px)
        at = pair.crop, number, int(pair.place is not None)
        self.kept.marks[at][: len(marks.scores)] = np.column_stack(
            [marks.scores, marks.x_px, marks.y_px]
        )
        if pair.place is not None:
            place = pair.place.x_px, pair.place.y_px, pair.place.radius_px
            self.kept.places[pair.crop, number] = place

    def _failed(self, pair: ChangePair, error: DetectorError) -> FailedPair:
        line = f"{self.kept.path}: {pair.name}: {error}"
        if self.work.is_strict:
            raise SweepError(line) from error
        self.opened.failures += 1
        if self.opened.failures >= _MOST_FAILURES and not self.opened.has_answered:
            raise SweepError(
                f"the detector gave nothing for {_MOST_FAILURES} pairs; the last: {line}"
            )
        return FailedPair(
            photograph=self.kept.path, pair=pair.name, reason=error.reason, message=str(error)
        )


@dataclass(slots=True, kw_only=True)
class _Opened:
    """The detector of this process, and how it does."""

    detector: CheckedDetector
    failures: int = 0
    has_answered: bool = False


@lru_cache(maxsize=1)
def _opened(spec: DetectorSpec, timeout_s: float) -> _Opened:
    """Open a detector once; it is closed with the process."""
    stack = ExitStack()
    atexit.register(stack.close)
    return _Opened(detector=stack.enter_context(open_detector(spec, timeout_s)))
