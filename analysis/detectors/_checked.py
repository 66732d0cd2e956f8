"""Opens a detector, and checks what it is given and what it says."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from typing import Protocol

import numpy as np

from acquisition.photographs import luma_plane
from analysis.detectors._hosts import ChildHost, CommandHost, unlike_the_followup
from analysis.detectors._spec import Detector, DetectorAnswer, DetectorSpec, takes_colour
from analysis.detectors.answers import exception_line, plain_answer, sees_reference
from analysis.errors import DetectorError, OverlapError
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray


class _DetectorHost(Protocol):
    """Where a detector runs. What it raises lacks the detector's name."""

    @property
    def takes_colour(self) -> bool:
        """Whether it is given colours; known once it has started."""
        ...

    def start(self) -> None:
        """Make ready for the first pair."""
        ...

    def answer(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> float | Float32Array:
        """Return what the detector says."""
        ...

    def renew(self) -> None:
        """Forget the state that a failure may have left."""
        ...

    def close(self) -> None:
        """End what was started."""
        ...


class _InProcess:
    """A detector in this process: its exceptions are caught, a hang is not.

    Parameters
    ----------
    function
        The detector.
    """

    def __init__(self, function: Detector) -> None:
        self._function = function

    @property
    def takes_colour(self) -> bool:
        """Whether the detector says so."""
        return takes_colour(self._function)

    def start(self) -> None:
        """Do nothing."""

    def renew(self) -> None:
        """Do nothing: its state is in this process."""

    def close(self) -> None:
        """Do nothing."""

    def answer(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> float | Float32Array:
        """Return what the detector says.

        Raises
        ------
        DetectorError
            If it raises anything, or returns neither a number nor an array.
        """
        try:
            return plain_answer(self._function(reference, followup, homography))
        except DetectorError:
            raise
        except (Exception, SystemExit) as error:
            raise DetectorError(f"it raised {exception_line(error)}", reason="crashed") from error


class CheckedDetector:
    """Asks a detector and checks what it answers; from `open_detector`.

    Parameters
    ----------
    name
        Of the detector, for messages.
    host
        Where it runs.
    """

    def __init__(self, name: str, host: _DetectorHost) -> None:
        self.name = name
        self._host = host

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.name}>"

    @property
    def takes_colour(self) -> bool:
        """Whether the detector is given colours; known once it has started."""
        return self._host.takes_colour

    def start(self) -> None:
        """Load the detector, so that one that is not there is found before the first pair.

        Raises
        ------
        DetectorError
            If it cannot be loaded.
        """
        try:
            self._host.start()
        except DetectorError as error:
            raise self._named(error) from error

    def __call__(
        self, reference: AnyArray, followup: AnyArray, homography: FloatArray
    ) -> DetectorAnswer:
        """Ask about one pair.

        Parameters
        ----------
        reference, followup
            Finite, shape ``(rows, cols)`` or ``(rows, cols, 3)`` each, linear in light. The
            detector gets copies: colours if it takes them, or else grey levels.
        homography
            Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.

        Raises
        ------
        DetectorError
            If it fails or its answer is not usable; the next call finds it as it was at first.
        OverlapError
            If no pixel of the follow-up sees the reference.
        ValueError
            If a photograph or the homography is none.
        """
        before, after = (
            self._given(_photograph(image, name))
            for image, name in ((reference, "reference"), (followup, "followup"))
        )
        matrix = np.array(homography, dtype=np.float64)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or np.linalg.det(matrix) == 0:
            raise ValueError("homography: expected 3 x 3 finite numbers that can be inverted")
        shape = after.shape[0], after.shape[1]
        inside = sees_reference((before.shape[0], before.shape[1]), shape, matrix)
        if not inside.any():
            raise OverlapError("no pixel of the follow-up sees the reference", shared_px=0)
        try:
            found = self._host.answer(before, after, matrix)
            try:
                return _checked(found, inside)
            except DetectorError:
                self._host.renew()
                raise
        except DetectorError as error:
            raise self._named(error) from error

    def _given(self, levels: Float32Array) -> Float32Array:
        """A photograph as the detector takes it."""
        if self.takes_colour == (levels.ndim == 3):
            return levels
        if self.takes_colour:
            return np.repeat(levels[:, :, np.newaxis], 3, axis=2)
        return luma_plane(levels).astype(np.float32)

    def _named(self, error: DetectorError) -> DetectorError:
        return DetectorError(f"detector {self.name}: {error}", reason=error.reason)


def _photograph(image: AnyArray, name: str) -> Float32Array:
    levels = np.array(image, dtype=np.float32, order="C")
    if levels.ndim not in (2, 3) or levels.shape[2:] not in ((), (3,)) or not levels.size:
        raise ValueError(
            f"{name}: expected an array of rows and columns, or of those and three colours, got "
            f"shape {levels.shape}"
        )
    if not np.isfinite(levels).all():
        raise ValueError(f"{name}: expected finite levels")
    return levels


def _checked(found: float | Float32Array, inside: BoolArray) -> DetectorAnswer:
    if isinstance(found, float):
        if not np.isfinite(found):
            raise DetectorError(
                f"it returned {found}; expected a finite number", reason="not_finite"
            )
        return DetectorAnswer(score=found)
    if found.shape != inside.shape:
        raise DetectorError(unlike_the_followup(found.shape, inside.shape), reason="shape")
    seen = found[inside]
    bad_px = int(np.count_nonzero(~np.isfinite(seen)))
    if bad_px:
        raise DetectorError(
            f"its map is not finite at {bad_px} of the {seen.size} px that show the reference",
            reason="not_finite",
        )
    return DetectorAnswer(score=float(seen.max()), map=np.where(inside, found, seen.min()))


@contextmanager
def open_detector(spec: DetectorSpec, timeout_s: float = 60.0) -> Iterator[CheckedDetector]:
    """Open a detector; what it started has ended when the block is left, also by Ctrl-C.

    Functions by name and ONNX files run in one process of their own for all pairs, a command in one
    a pair. The built-in detectors and callables run in this process.

    Parameters
    ----------
    spec
        Which one.
    timeout_s
        For an answer of what runs in a process of its own; loading it may take 120 s.

    Raises
    ------
    DetectorError
        If it cannot be loaded; and from each call, if it fails.
    ValueError
        If the time is not above 0.
    """
    if not 0 < timeout_s < inf:
        raise ValueError(f"timeout_s must be above 0 and finite, got {timeout_s:g}")
    host = _host(spec, timeout_s)
    try:
        detector = CheckedDetector(spec.name, host)
        detector.start()
        yield detector
    finally:
        host.close()


def _host(spec: DetectorSpec, timeout_s: float) -> _DetectorHost:
    if spec.function is not None:
        return _InProcess(spec.function)
    if spec.kind == "built-in":
        from analysis.detectors.built_in import FUNCTIONS  # takes a second, for those who use it

        return _InProcess(FUNCTIONS[spec.text])
    if spec.kind == "command":
        return CommandHost(spec, timeout_s)
    return ChildHost(spec, timeout_s)
