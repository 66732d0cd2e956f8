"""The child's side of a detector in a process of its own: it loads the detector and asks it."""

import json
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from analysis.detectors._spec import Detector, takes_colour
from analysis.detectors.answers import exception_line, plain_answer
from analysis.errors import DetectorError, DetectorFault
from simulation.arrays import Float32Array, FloatArray


def serve(requests: Connection, answers: Connection, told: dict[str, Any]) -> None:
    """Load the detector that the parent told, say so, and answer until the pipe is closed.

    It says so with ``colour``, whether the detector takes colours. A request is its header as JSON,
    then the bytes of both photographs. An answer is a header with ``score``, with ``map`` (the
    shape; its bytes follow) or with ``fault`` and ``line``.
    """
    loaders: dict[str, Callable[[str], Detector]] = {
        "function": _imported,
        "onnx": _onnx_model,
        "learned": _learned,
    }
    try:
        detector = loaders[told["kind"]](told["target"])
        is_colour = takes_colour(detector)
    except DetectorError as error:
        return _say_fault(answers, error.reason, str(error))
    except BaseException as error:  # noqa: BLE001 - whatever the user's module raises, also exits
        return _say_fault(answers, "missing", f"it cannot be loaded: {exception_line(error)}")
    _say(answers, {"colour": is_colour})
    while True:
        try:
            asked = json.loads(requests.recv_bytes())
            images = [_image(requests, asked[name]) for name in ("reference", "followup")]
        except EOFError:
            return None
        _answer(answers, detector, images, np.array(asked["homography"], dtype=np.float64))


def _answer(
    answers: Connection, detector: Detector, images: list[Float32Array], homography: FloatArray
) -> None:
    try:
        found = plain_answer(detector(images[0], images[1], homography))
    except DetectorError as error:
        return _say_fault(answers, error.reason, str(error))
    except BaseException as error:  # noqa: BLE001 - whatever the user's code raises, also exits
        return _say_fault(answers, "crashed", f"it raised {exception_line(error)}")
    if isinstance(found, float):
        return _say(answers, {"score": found})
    _say(answers, {"map": found.shape})
    return answers.send_bytes(found.tobytes())


def _imported(target: str) -> Detector:
    """The function of a text ``module:function``."""
    module_name, _, function_name = target.partition(":")
    try:
        found: Any = import_module(module_name)
    except ImportError as error:
        raise DetectorError(
            f"it cannot be imported: {exception_line(error)}; run in the folder of {module_name}, "
            "or put that on PYTHONPATH",
            reason="missing",
        ) from error
    for name in function_name.split("."):
        found = getattr(found, name, None)
    if not callable(found):
        raise DetectorError(
            f"module {module_name} has no function {function_name}; check its name",
            reason="missing",
        )
    function: Detector = found
    return function


def _onnx_model(target: str) -> Detector:
    from analysis.detectors._onnx_model import onnx_detector  # SciPy, which not every child needs

    return onnx_detector(target)


def _learned(target: str) -> Detector:
    from analysis.detectors.learned import load_learned  # likewise

    return load_learned(target)


def _image(requests: Connection, shape: list[int]) -> Float32Array:
    image = np.empty(shape, dtype=np.float32)
    if requests.recv_bytes_into(image.data.cast("B")) != image.nbytes:
        raise EOFError("the parent sent less than it said")
    return image


def _say(answers: Connection, header: dict[str, Any]) -> None:
    answers.send_bytes(json.dumps(header).encode())


def _say_fault(answers: Connection, fault: DetectorFault, line: str) -> None:
    _say(answers, {"fault": fault, "line": line})
