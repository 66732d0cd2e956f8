"""Artefact statistics of many images: one cell per image, on one machine or a Dask cluster.

A cell draws no random number and sums in a fixed order, so that the results are the same bits
for any number of workers. Finished cells are appended to a file and found again by what went
into them.
"""

import hashlib
import json
import os
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import ceil, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config

from acquisition.session import atomic_write
from acquisition.untrusted import parse_json
from analysis.detectability.artefact import ArtefactTiles
from analysis.detectability.dprime import scene_artefact
from analysis.detectability.scenario import Scenario
from analysis.errors import AnalysisError, ResultsFileError
from simulation import Model
from simulation.arrays import FloatArray

_VERSION = 3
"""Version of a cell's contents; older cells are recomputed."""

_TILES_WANTED = 16
"""Tiles in all that a bootstrap can draw from; sixteen images need no tiles."""

_CONNECT_S = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """What is measured on every image; ``reading`` states how the files are read."""

    scenario: Scenario
    models: tuple[Model, ...]
    zooms: tuple[float, ...]
    tiles_per_side: int
    reading: str = ""

    @property
    def key(self) -> str:
        """The plan as text, the same for equal plans."""
        return json.dumps({"version": _VERSION, **asdict(self)}, sort_keys=True)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneStatistics:
    """Statistics of one image: its mean level, and the artefact for every model and zoom.

    ``products_dn2`` has the shape (models, zooms, tiles, n, 2 n - 1), the rows of lags from
    -(n - 1) to 0; ``pixels`` the shape (models, zooms, tiles).
    """

    mean_dn: float
    products_dn2: FloatArray
    pixels: FloatArray

    def artefact(self, model: int, zoom: int) -> ArtefactTiles:
        """Artefact for the plan's model and zoom with these indices."""
        half = self.products_dn2[model, zoom]
        # The other half follows from evenness in the lag.
        other = half[:, -2::-1, ::-1]
        return ArtefactTiles(
            products_dn2=np.concatenate([half, other], axis=1), pixels=self.pixels[model, zoom]
        )


def tiles_per_side(images: int) -> int:
    """Return the number of tiles along each axis of an image, given the number of images."""
    return ceil(sqrt(_TILES_WANTED / images)) if images < _TILES_WANTED else 1


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepWorkers:
    """Where images are measured: in processes on this machine, or on a Dask cluster.

    Parameters
    ----------
    count
        Processes on this machine; 1 works in this one.
    scheduler
        Address of a Dask scheduler, ``tcp://host:port``, in place of ``count``.
    """

    count: int = 1
    scheduler: str | None = None


def scene_statistics(scene_dn: FloatArray, plan: SweepPlan) -> SceneStatistics:
    """Measure one image: the artefact of every model and zoom of a plan.

    Parameters
    ----------
    scene_dn
        The image c, grey, shape ``(rows, cols)``, finite.
    plan
        What is measured.

    Raises
    ------
    ValueError
        If the image is too small for a zoom and the window.
    """
    n = plan.scenario.window_px
    products, pixels = [], []
    for model in plan.models:
        tiles = [
            scene_artefact(scene_dn, plan.scenario, model, zoom, plan.tiles_per_side)
            for zoom in plan.zooms
        ]
        products.append([one.products_dn2[:, :n] for one in tiles])
        pixels.append([one.pixels for one in tiles])
    return SceneStatistics(
        mean_dn=float(scene_dn.mean()), products_dn2=np.array(products), pixels=np.array(pixels)
    )


def sweep_images(
    paths: Sequence[Path],
    load: Callable[[Path], FloatArray],
    plan: SweepPlan,
    *,
    results: Path | None = None,
    workers: SweepWorkers | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> list[SceneStatistics]:
    """Measure every image, in the order of ``paths``; finished cells are not measured again.

    Parameters
    ----------
    paths
        Image files; a cluster's workers must find them under the same names.
    load
        Grey image of a file; a function that a worker process can import.
    plan
        What is measured.
    results
        File that finished cells are appended to.
    workers
        Who measures; None for this process.
    progress
        Called with the number of finished images.

    Raises
    ------
    AnalysisError
        If an image is too small, there is no such scheduler or Dask is not installed.
    ResultsFileError
        If an image or the results file cannot be read or written.
    """
    keys = [_cell_key(path, plan) for path in paths]
    known = _read_cells(results)
    missing = [(key, path) for key, path in dict(zip(keys, paths, strict=True)).items()]
    missing = [(key, path) for key, path in missing if key not in known]
    done = len(set(keys)) - len(missing)
    progress(done)
    if missing:
        with _backend(workers or SweepWorkers()) as jobs:
            found = Parallel(n_jobs=jobs, return_as="generator")(
                delayed(_measured)(path, load, plan) for _, path in missing
            )
            for (key, path), cell in zip(missing, found, strict=True):
                known[key] = cell
                _append(results, {"key": key, "image": path.name, **_stored(cell)})
                done += 1
                progress(done)
    return [known[key] for key in keys]


def _measured(path: Path, load: Callable[[Path], FloatArray], plan: SweepPlan) -> SceneStatistics:
    scene_dn = load(path)
    try:
        return scene_statistics(scene_dn, plan)
    except ValueError as error:
        raise AnalysisError(f"{path}: {error}") from error


def _cell_key(path: Path, plan: SweepPlan) -> str:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ResultsFileError(f"cannot read {path}: {error.strerror}", source=str(path)) from error
    return hashlib.sha256(plan.key.encode() + hashlib.sha256(content).digest()).hexdigest()


def _stored(cell: SceneStatistics) -> dict[str, Any]:
    return {
        "mean_dn": cell.mean_dn,
        **{
            name: {"shape": values.shape, "float64": b64encode(values.tobytes()).decode("ascii")}
            for name, values in (("products_dn2", cell.products_dn2), ("pixels", cell.pixels))
        },
    }


def _read_cells(path: Path | None) -> dict[str, SceneStatistics]:
    """Read the finished cells; a line cut short by a kill is taken off."""
    if path is None or not path.is_file():
        return {}
    try:
        text = path.read_bytes()
        whole = text[: text.rfind(b"\n") + 1]
        if whole != text:
            atomic_write(path, whole)
        lines = [parse_json(line) for line in whole.splitlines()]
        return {
            line["key"]: SceneStatistics(
                mean_dn=line["mean_dn"],
                products_dn2=_array(line["products_dn2"]),
                pixels=_array(line["pixels"]),
            )
            for line in lines
        }
    except OSError as error:
        raise ResultsFileError(f"cannot read {path}: {error.strerror}", source=str(path)) from error
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsFileError(
            f"{path}: contains no valid cells: {error}; delete it", source=str(path)
        ) from error


def _array(stored: dict[str, Any]) -> FloatArray:
    return np.frombuffer(b64decode(stored["float64"])).reshape(stored["shape"])


def _append(path: Path | None, line: dict[str, Any]) -> None:
    if path is None:
        return
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {path}: {error.strerror}", source=str(path)
        ) from error


@contextmanager
def _backend(workers: SweepWorkers) -> Iterator[int]:
    """Choose joblib's backend; yields the number of jobs, -1 for all that a cluster has."""
    scheduler = workers.scheduler
    if scheduler is None:
        with parallel_config(backend="loky", inner_max_num_threads=1):
            yield workers.count
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise AnalysisError(
            "a Dask cluster needs the extra cluster: pip install 'standoff[cluster]'"
        ) from error
    try:
        client: Any = Client(scheduler, timeout=_CONNECT_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise AnalysisError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client, parallel_config(backend="dask", wait_for_workers_timeout=_CONNECT_S):
        yield -1
