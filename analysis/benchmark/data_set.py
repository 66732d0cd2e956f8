"""A data set of the benchmark: its tasks and truths, each file held against the manifest."""

from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from pydantic import BaseModel

from acquisition.untrusted import parse_json
from analysis.benchmark.pictures import Shape, file_bytes, grey_levels
from analysis.benchmark.stored_models import Manifest, Track
from analysis.errors import ResultsFileError
from calibration.documents import fitted
from simulation.arrays import Float32Array

MANIFEST_NAME = "manifest.json"

_REMEDY = "make the data set anew with standoff benchmark make"
_Model = TypeVar("_Model", bound=BaseModel)


class _Named(BaseModel):
    """A truth, as far as its tasks are counted."""

    tasks: dict[str, object]


class BenchmarkData:
    """The folder of a data set.

    Parameters
    ----------
    folder
        With its manifest.json.

    Raises
    ------
    ResultsFileError
        If the manifest cannot be read, or is none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / MANIFEST_NAME
        self.manifest = document(file_bytes(path), path, Manifest)

    def has(self, track: Track) -> bool:
        """Whether there are tasks of a track."""
        return f"truth/{track}.json" in self.manifest.files

    def tasks_of(self, track: Track) -> int:
        """Return how many tasks a track has.

        Raises
        ------
        ResultsFileError
            If their truth is not that of the manifest, or does not fit.
        """
        return len(self.read(f"truth/{track}.json", _Named).tasks)

    def read(self, name: str, model: type[_Model]) -> _Model:
        """Read one of its JSON files.

        Raises
        ------
        ResultsFileError
            If it is not that of the manifest, or does not fit.
        """
        return document(self._bytes(name), self.folder / name, model)

    def levels(self, name: str, shape: Shape | None = None) -> Float32Array:
        """Read one of its linear pictures, shape (rows, cols), in the levels of its file.

        Raises
        ------
        ResultsFileError
            If it is not that of the manifest, or of another shape.
        """
        return grey_levels(self._bytes(name), self.folder / name, shape)

    def encoded(self, name: str) -> Float32Array:
        """Read one of its sRGB pictures, shape (rows, cols), in the levels of its file.

        Raises
        ------
        ResultsFileError
            If it is not that of the manifest, or no picture.
        """
        data = np.frombuffer(self._bytes(name), np.uint8)
        levels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        if levels is None:
            raise self._refused(name, f"is no picture; {_REMEDY}")
        return np.asarray(levels, np.float32)

    def _bytes(self, name: str) -> bytes:
        stated = self.manifest.files.get(name)
        if stated is None:
            raise self._refused(name, f"is not in {MANIFEST_NAME}; {_REMEDY}")
        # A name that leaves the folder could name any file of the machine.
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise self._refused(name, f"lies outside of the data set; {_REMEDY}")
        data = file_bytes(self.folder / name)
        if sha256(data).hexdigest() != stated.sha256:
            raise self._refused(name, f"is not the file that {MANIFEST_NAME} names; {_REMEDY}")
        return data

    def _refused(self, name: str, problem: str) -> ResultsFileError:
        return ResultsFileError(f"{self.folder / name} {problem}", source=str(self.folder / name))


def document(data: bytes, path: Path, model: type[_Model]) -> _Model:
    """Return the content of a JSON file as its model.

    Raises
    ------
    ResultsFileError
        If it is no JSON, repeats a key, or does not fit.
    """
    try:
        content = parse_json(data, has_single_keys=True)
    except ValueError as error:
        raise ResultsFileError(f"{path}: not JSON: {error}", source=str(path)) from error
    return fitted(content, model, ResultsFileError, str(path))
