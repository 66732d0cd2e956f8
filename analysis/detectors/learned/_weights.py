"""A trained network as a detector, and the file that keeps it."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from acquisition.photographs import luma_plane
from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.session import commit_file
from analysis.detectors.answers import followup_view
from analysis.errors import DetectorError, ResultsFileError
from simulation.arguments import FilePath, checked, path_of
from simulation.arrays import Float32Array, FloatArray

if TYPE_CHECKING:
    from torch import Tensor

    from analysis.detectors.learned._network import SiameseNetwork

_LEARNED_SCHEMA: Final = "standoff.learned-detector/1"
_LARGEST_BYTES = 1 << 26
_ONNX_OPSET = 17


class LearnedDetector:
    """A trained network as a `Detector`; its score is the log odds of a change at each pixel.

    Parameters
    ----------
    network
        The trained network.
    """

    def __init__(self, network: "SiameseNetwork") -> None:
        self.network = network.eval()

    def __call__(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> Float32Array:
        """Compare a follow-up with its reference; see `Detector`."""
        import torch

        images = torch.from_numpy(on_one_grid(reference, followup, homography)[np.newaxis])
        with one_thread(), torch.inference_mode():
            odds = self.network(images)[0, 0].numpy()
        return np.array(odds, np.float32)

    def save(self, path: Path | str) -> None:
        """Write the weights, whole or not at all, to a file that ``standoff evaluate`` takes.

        Raises
        ------
        ResultsFileError
            If the file cannot be written.
        """
        import torch

        file = BytesIO()
        torch.save({"schema": _LEARNED_SCHEMA, "weights": self.network.state_dict()}, file)
        try:
            commit_file(Path(path), file.getvalue())
        except OSError as error:
            raise ResultsFileError(
                f"cannot write {on_one_line(path)}: {error.strerror}", source=str(path)
            ) from error

    def export_onnx(self, path: Path | str) -> None:
        """Write an ONNX file that takes frames of any size; needs the package ``onnx``.

        Raises
        ------
        DetectorError
            If ``onnx`` is not installed.
        ResultsFileError
            If the file cannot be written.
        """
        if find_spec("onnx") is None:
            raise DetectorError("an ONNX file needs onnx: pip install onnx", reason="missing")
        import warnings

        import torch

        axes = {0: "pairs", 2: "rows", 3: "columns"}
        file = BytesIO()
        with warnings.catch_warnings():
            # The exporter that succeeds this one needs a further package.
            warnings.simplefilter("ignore", DeprecationWarning)
            torch.onnx.export(
                self.network,
                (torch.zeros(1, 2, 64, 64),),
                file,  # type: ignore[arg-type] # a file as well, to this exporter
                input_names=["photographs"],
                output_names=["log_odds"],
                dynamic_axes={"photographs": axes, "log_odds": axes},
                opset_version=_ONNX_OPSET,
                dynamo=False,
            )
        try:
            commit_file(Path(path), file.getvalue())
        except OSError as error:
            raise ResultsFileError(
                f"cannot write {on_one_line(path)}: {error.strerror}", source=str(path)
            ) from error


def on_one_grid(
    reference: Float32Array, followup: Float32Array, homography: FloatArray
) -> Float32Array:
    """Return the grey levels of both photographs on the follow-up's grid, ``(2, rows, cols)``.

    Where the reference shows nothing, its levels are those of the follow-up, as for ONNX files.
    """
    near, far = (luma_plane(one) if one.ndim == 3 else one for one in (reference, followup))
    seen = followup_view(near, (far.shape[0], far.shape[1]), homography)
    before = np.where(seen.inside, seen.levels, far)
    return np.stack([before, far]).astype(np.float32)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let PyTorch use one thread in the block: the same bits on any machine's number of cores.

    For images as small as these a second thread gains little, and where the cores are busy it costs
    a multiple.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def require_torch() -> None:
    """Raise a DetectorError if PyTorch is not installed."""
    if find_spec("torch") is None:
        raise DetectorError(
            "a learned detector needs PyTorch: pip install 'standoff[learned]'", reason="missing"
        )


@checked
def load_learned(path: FilePath) -> LearnedDetector:
    """Return the detector in a file of `LearnedDetector.save`; no code in the file is run.

    Parameters
    ----------
    path
        Path of the file.

    Returns
    -------
    LearnedDetector
        The detector; a call returns a map of the log odds of a change.

    Raises
    ------
    DetectorError
        If PyTorch is not installed, or the file cannot be read, is damaged or of another kind;
        ``reason`` is then ``missing``.

    Examples
    --------
    >>> detector = standoff.load_learned("detector.pt")  # doctest: +SKIP
    """
    require_torch()
    import torch

    from analysis.detectors.learned._network import SiameseNetwork

    file = path_of(path, "path")
    name = on_one_line(path)
    try:
        content = read_regular_file(file, _LARGEST_BYTES)
    except OSError as error:
        why = error.strerror or str(error)
        raise DetectorError(f"cannot read {name}: {why}", reason="missing") from error
    except ValueError as error:
        raise DetectorError(f"{name}: {error}", reason="missing") from error
    damaged = DetectorError(
        f"{name} is damaged, or is not the file of a learned detector; train it again",
        reason="missing",
    )
    try:
        stored: Any = torch.load(BytesIO(content), map_location="cpu", weights_only=True)
    except (RuntimeError, UnpicklingError, EOFError, ValueError, KeyError, AttributeError) as error:
        raise damaged from error
    if not isinstance(stored, dict) or not isinstance(stored.get("weights"), dict):
        raise damaged
    if stored.get("schema") != _LEARNED_SCHEMA:
        raise DetectorError(
            f"{name} is of schema {on_one_line(str(stored.get('schema')))!s:.60}, "
            f"expected {_LEARNED_SCHEMA}",
            reason="missing",
        )
    network = SiameseNetwork()
    try:
        network.load_state_dict(stored["weights"])
    except (RuntimeError, TypeError, AttributeError) as error:
        raise damaged from error
    if not all(_is_finite(weight) for weight in network.parameters()):
        raise damaged
    return LearnedDetector(network)


def _is_finite(weight: "Tensor") -> bool:
    return bool(weight.isfinite().all())
