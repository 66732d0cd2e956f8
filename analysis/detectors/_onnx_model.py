"""Change detection networks as ONNX files."""

from importlib import import_module
from typing import Any

import numpy as np

from analysis.detectors._spec import Detector
from analysis.detectors.answers import FollowupView, exception_line, followup_view
from analysis.errors import DetectorError
from simulation.arrays import Float32Array, FloatArray

_QUIET = 3  # onnxruntime's severity from which on it speaks: errors


def onnx_detector(path: str) -> Detector:
    """Open a network that takes both photographs on the follow-up's grid.

    Its input is ``N x 2 x H x W`` of float32: channel 0 is the reference, resampled by a cubic
    spline to the follow-up's pixels, and the follow-up itself where the reference shows nothing;
    channel 1 is the follow-up. With ``N x 6 x H x W`` it takes colours: red, green and blue of the
    reference, then of the follow-up. Levels are as they come. Its first output is a map,
    ``N x 1 x H x W``, or a number, ``N`` or ``N x 1``; N is 1 here. It runs on one thread of the
    processor.

    Raises
    ------
    DetectorError
        If onnxruntime is not installed, the file cannot be loaded, or the input is another.
    """
    try:
        runtime = import_module("onnxruntime")
    except ImportError as error:
        raise DetectorError(
            "an ONNX file needs onnxruntime: pip install 'standoff[onnx]'", reason="missing"
        ) from error
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = _QUIET
    try:
        session = runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common base
        raise DetectorError(
            f"it cannot be loaded: {exception_line(error)}; export the model again",
            reason="missing",
        ) from error
    inputs = session.get_inputs()
    shape = inputs[0].shape if len(inputs) == 1 else None
    # A dimension that is not fixed has a name, or none.
    if shape is None or len(shape) != 4 or (isinstance(shape[1], int) and shape[1] not in (2, 6)):
        shown = ", ".join(" x ".join(map(str, one.shape)) for one in inputs)
        raise DetectorError(
            f"it takes {shown}; expected one input of N x 2 x H x W, or N x 6 x H x W",
            reason="shape",
        )
    return _OnnxDetector(session, inputs[0].name, shape[2:], colour=shape[1] == 6)


class _OnnxDetector:
    """A session of onnxruntime as a detector; ``frame`` is the height and width that it takes."""

    def __init__(
        self,
        session: Any,  # noqa: ANN401
        input_name: str,
        frame: list[Any],
        *,
        colour: bool,
    ) -> None:
        self.colour = colour
        self._session = session
        self._input_name = input_name
        self._frame = frame

    def __call__(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> float | Float32Array:
        for size, taken in zip(followup.shape[:2], self._frame, strict=True):
            if isinstance(taken, int) and taken != size:
                shown = " x ".join(map(str, self._frame))
                rows, cols = followup.shape[:2]
                raise DetectorError(
                    f"it takes only {shown} px, but the follow-up has {rows} x {cols}; export it "
                    "with dynamic height and width",
                    reason="shape",
                )
        planes = [np.atleast_3d(image).transpose(2, 0, 1) for image in (reference, followup)]
        before = [
            _seen_or(followup_view(near, (far.shape[0], far.shape[1]), homography), far)
            for near, far in zip(*planes, strict=True)
        ]
        given = np.stack([*before, *planes[1]])[np.newaxis]
        answer = np.asarray(self._session.run(None, {self._input_name: given})[0])
        if answer.size == 1 and answer.ndim <= 2:
            return float(answer.item())
        if answer.ndim == 4 and answer.shape[:2] == (1, 1):
            return np.asarray(answer[0, 0], dtype=np.float32)
        shown = " x ".join(map(str, answer.shape))
        raise DetectorError(
            f"it returned {shown} values; expected N x 1 x H x W, or N x 1", reason="shape"
        )


def _seen_or(seen: FollowupView, followup: Float32Array) -> Float32Array:
    """What is seen of the reference, and the follow-up where nothing is."""
    return np.where(seen.inside, seen.levels, followup).astype(np.float32)
