"""What a detector said of the pairs of a photograph, as it is kept between runs."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from analysis.evaluation.roc import MOST_MARKS as MARKS, Disc, MarkedPair, Marks
from analysis.results_file import StoredValues
from simulation.arrays import FloatArray


class FailedPair(StoredValues):
    """A pair of which a detector gave nothing.

    ``reason`` is ``crashed``, ``hung``, ``not_finite``, ``shape``, ``missing`` or ``output``.
    """

    photograph: str
    pair: str
    reason: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotographScores:
    """Scores of the pairs of one photograph.

    Parameters
    ----------
    path, sha256, encoding
        The photograph: its path as it is printed, its content, how its levels were read.
    scores
        Shape (crops, conditions, 2): without and with a change; NaN of failed pairs.
    is_done
        Shape (crops, conditions): whether the pairs were tried.
    marks
        Score, x and y of the highest local maxima of the maps, shape (crops, conditions, 2,
        ``MARKS``, 3), falling; NaN where there are no more.
    places
        x, y and radius of the change in the follow-up, shape (crops, conditions, 3).
    failed
        Pairs without a score.
    is_colour
        Whether the pairs are in colour.
    """

    path: str
    sha256: str
    encoding: str
    scores: FloatArray
    is_done: NDArray[np.bool_]
    marks: NDArray[np.float32]
    places: NDArray[np.float32]
    failed: list[FailedPair] = field(default_factory=list)
    is_colour: bool = False

    @classmethod
    def empty(cls, path: str, sha256: str, encoding: str, shape: tuple[int, int]) -> Self:
        """Nothing yet, for ``shape`` crops and conditions."""
        return cls(
            path=path,
            sha256=sha256,
            encoding=encoding,
            scores=np.full((*shape, 2), np.nan),
            is_done=np.zeros(shape, np.bool_),
            marks=np.full((*shape, 2, MARKS, 3), np.nan, np.float32),
            places=np.full((*shape, 3), np.nan, np.float32),
        )

    def marked(self, condition: int) -> list[MarkedPair]:
        """Return what the maps of a condition mark; of no map, an empty list."""
        pairs: list[MarkedPair] = []
        if not np.isfinite(self.marks[:, condition]).any():
            return pairs
        for crop, kind in product(range(len(self.scores)), (0, 1)):
            if not np.isfinite(self.scores[crop, condition, kind]):
                continue
            found = self.marks[crop, condition, kind].astype(np.float64)
            score, x, y = found[np.isfinite(found[:, 0])].T
            x_px, y_px, radius_px = self.places[crop, condition].tolist()
            pairs.append(
                MarkedPair(
                    marks=Marks(scores=score, x_px=x, y_px=y),
                    change=Disc(x_px=x_px, y_px=y_px, radius_px=radius_px) if kind else None,
                )
            )
        return pairs


_ARRAYS = ("scores", "is_done", "marks", "places")


def scores_bytes(key: str, photographs: Sequence[PhotographScores], about: object) -> bytes:
    """Return the content of a file of scores; ``about`` is any JSON value, kept beside them."""
    told = [
        {
            **{name: getattr(one, name) for name in ("path", "sha256", "encoding")},
            "failed": [failed.model_dump() for failed in one.failed],
            "is_colour": one.is_colour,
        }
        for one in photographs
    ]
    arrays = {
        f"{name}{number}": getattr(one, name)
        for number, one in enumerate(photographs)
        for name in _ARRAYS
    }
    head = np.frombuffer(
        json.dumps({"key": key, "about": about, "photographs": told}).encode(), np.uint8
    )
    file = BytesIO()
    np.savez_compressed(file, head=head, **arrays)
    return file.getvalue()


def read_photograph_scores(path: Path, key: str) -> tuple[list[PhotographScores], object] | None:
    """Read a file of scores; None if it is not there, damaged, or its key begins otherwise."""
    try:
        with np.load(
            BytesIO(read_regular_file(path, LARGEST_IMAGE_BYTES)), allow_pickle=False
        ) as stored:
            head = json.loads(stored["head"].tobytes())
            if not head["key"].startswith(key):
                return None
            photographs = [
                PhotographScores(
                    **{name: told[name] for name in ("path", "sha256", "encoding")},
                    **{name: stored[f"{name}{number}"] for name in _ARRAYS},
                    failed=[FailedPair.model_validate(one) for one in told["failed"]],
                    is_colour=told.get("is_colour", False),  # earlier files lack it
                )
                for number, told in enumerate(head["photographs"])
            ]
            return photographs, head["about"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError):
        return None
