"""The pairs of one photograph as one file."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from acquisition.printable import on_one_line
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from analysis.errors import ResultsFileError
from analysis.evaluation.task import Condition
from simulation.arrays import BoolArray, Float32Array, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledPair:
    """A reference and a follow-up, and what changed between them.

    Parameters
    ----------
    reference, followup
        Shape ``(rows, cols)`` each, or ``(rows, cols, 3)`` of a photograph in colour; levels in DN,
        linear in light.
    homography
        Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.
    is_changed
        Whether there is a change.
    mask
        The follow-up's pixels that show more than half of the change's peak, ``(rows, cols)``.
    condition
        Pose, noise and contrast; the contrast also of a pair without a change.
    sigma_px
        Width of the change in px of the photograph.
    """

    reference: Float32Array = field(repr=False)
    followup: Float32Array = field(repr=False)
    homography: NDArray[np.float64] = field(repr=False)
    is_changed: bool
    mask: BoolArray = field(repr=False)
    condition: Condition
    sigma_px: float


def pairs_bytes(pairs: Sequence[LabelledPair]) -> bytes:
    """Return the content of a file of pairs, an ``.npz``.

    It has ``reference`` (pairs, rows, cols), or (pairs, rows, cols, 3) in colour, ``homography``
    (pairs, 3, 3), ``is_changed`` (pairs,), for each pair ``followup_K`` and ``mask_K``, whose
    shapes differ, and ``conditions``, the bytes of a JSON list.
    """
    told = [{**asdict(pair.condition), "sigma_px": pair.sigma_px} for pair in pairs]
    arrays: dict[str, NDArray[np.generic]] = {
        "reference": np.stack([pair.reference for pair in pairs]),
        "homography": np.stack([pair.homography for pair in pairs]),
        "is_changed": np.array([pair.is_changed for pair in pairs]),
        "conditions": np.frombuffer(json.dumps(told).encode(), np.uint8),
    }
    for number, pair in enumerate(pairs):
        arrays[f"followup_{number}"] = pair.followup
        arrays[f"mask_{number}"] = pair.mask
    file = BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def read_pairs(path: Path) -> list[LabelledPair]:
    """Read a file of pairs.

    Raises
    ------
    ResultsFileError
        If it cannot be read, or is none.
    """
    try:
        content = BytesIO(read_regular_file(path, LARGEST_IMAGE_BYTES))
        with np.load(content, allow_pickle=False) as stored:
            references, homographies = stored["reference"], stored["homography"]
            told = json.loads(stored["conditions"].tobytes())
            return [
                LabelledPair(
                    reference=references[number],
                    followup=_image(stored[f"followup_{number}"]),
                    homography=np.asarray(homographies[number], np.float64),
                    is_changed=bool(is_changed),
                    mask=np.asarray(stored[f"mask_{number}"], np.bool_),
                    sigma_px=float(told[number].pop("sigma_px")),
                    condition=Condition(**told[number]),
                )
                for number, is_changed in enumerate(stored["is_changed"])
            ]
    except OSError as error:
        why = error.strerror or str(error)
        raise ResultsFileError(f"cannot read {on_one_line(path)}: {why}") from error
    except (ValueError, KeyError, TypeError, IndexError, EOFError, BadZipFile) as error:
        raise ResultsFileError(
            f"{on_one_line(path)} is damaged or no file of pairs; run the command that made it"
        ) from error


def _image(levels: FloatArray) -> Float32Array:
    if levels.ndim not in (2, 3) or levels.shape[2:] not in ((), (3,)):
        raise ValueError("no image")
    if levels.dtype != np.float32:
        raise ValueError("no image")
    return np.asarray(levels, np.float32)
