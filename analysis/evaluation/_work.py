"""Scores a detector on the pairs of photographs; within one photograph, too, it is resumed."""

import atexit
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import monotonic

import numpy as np

from acquisition.printable import on_one_line
from analysis.detectability import SceneImage
from analysis.detectors import CheckedDetector, DetectorSpec, open_detector
from analysis.errors import DetectorError, SweepError
from analysis.evaluation._document import FailedPair, PhotographScores, scores_bytes, scores_of
from analysis.evaluation.pairs import ChangePair, PairMaker
from analysis.evaluation.roc import MOST_MARKS as MARKS, marks_of
from analysis.evaluation.task import EvaluationTask, LaterScene
from analysis.sweep import Batch, Commit, Record, SweepItem, SweepWork
from simulation import Psf
from simulation.arrays import Float32Array, FloatArray

_SAVED_EVERY_S = 20.0
_MOST_FAILURES = 25
"""Pairs without a score, one after the other and none before with one, that end the work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationWork(SweepWork):
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
    depth
        Likewise the depth of that photograph's scene; None for flat scenes.
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
    depth: Callable[[Path], FloatArray] | None = None
    reading: str
    folder: Path
    timeout_s: float = 60.0
    is_strict: bool = False

    commits_each = True

    @property
    def key(self) -> str:
        """See `SweepWork.key`."""
        return self.task.key(self.psf, self.detector.identity, self.reading)

    @property
    def state(self) -> Path:
        """See `SweepWork.state`."""
        return self.folder

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Score the pairs of a photograph; one with pairs without a score is tried again later."""
        scene = self.load(item.path)
        maker = self._maker(scene, item.path)
        earlier = batch.earlier(item)
        if earlier is None:
            shape = self.task.crops, len(self.task.conditions)
            empty = PhotographScores.empty(
                on_one_line(item.path), scene.sha256, scene.encoding, shape
            )
            scores = replace(empty, is_colour=maker.is_colour)
        else:
            scores = scores_of(earlier)
            scores.failed.clear()
            np.logical_and(scores.is_done, np.isfinite(scores.scores).all(-1), out=scores.is_done)

        def record() -> Record:
            is_final = bool(scores.is_done.all()) and not scores.failed
            data = scores_bytes(scores)
            return Record(
                items=(item,), rows=({},), notes=dict(scene.notes), data=data, is_final=is_final
            )

        self._complete(scores, maker, lambda: commit([record()]))
        return record()

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
            levels_dn=levels_dn,
            digest=scene.sha256,
            task=self.task,
            psf=self.psf,
            later=later,
            depth=None if self.depth is None else self.depth(path),
        )

    @property
    def _own_detector(self) -> "_Opened":
        return _opened(self.detector, self.timeout_s)

    def _complete(
        self,
        kept: PhotographScores,
        maker: PairMaker,
        save: Callable[[], None],
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
                    save()
                    saved_s = monotonic()
        except BaseException:
            save()
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
