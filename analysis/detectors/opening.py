"""A detector made ready to be asked, and ended in any case."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf

from analysis.detectors.checked import CheckedDetector, DetectorHost, InProcess
from analysis.detectors.child_host import ChildHost
from analysis.detectors.command_host import CommandHost
from analysis.detectors.spec import DetectorSpec


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


def _host(spec: DetectorSpec, timeout_s: float) -> DetectorHost:
    if spec.function is not None:
        return InProcess(spec.function)
    if spec.kind == "built-in":
        from analysis.detectors.built_in import FUNCTIONS  # takes a second, for those who use it

        return InProcess(FUNCTIONS[spec.text])
    if spec.kind == "command":
        return CommandHost(spec, timeout_s)
    return ChildHost(spec, timeout_s)
