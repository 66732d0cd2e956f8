import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from analysis.detectability.dprime import scene_artefact
from analysis.detectability.scenario import Scenario
from analysis.detectability.sweep import (
    SceneStatistics,
    SweepPlan,
    SweepWorkers,
    sweep_images,
    tiles_per_side,
)
from analysis.errors import AnalysisError, ResultsFileError
from simulation import GaussianPsf
from simulation.arrays import FloatArray

PLAN = SweepPlan(
    scenario=Scenario(psf=GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8), window_px=9),
    models=("bicubic", "matched"),
    zooms=(1.0, 1.4),
    tiles_per_side=2,
)


NOBODY = SweepWorkers(scheduler="tcp://127.0.0.1:1")


def load(path: Path) -> FloatArray:
    return np.asarray(np.load(path), dtype=np.float64)


def refuse(path: Path) -> FloatArray:
    raise AssertionError(f"{path} is measured again")


@pytest.fixture
def paths(tmp_path: Path) -> list[Path]:
    found = []
    for number in range(5):
        path = tmp_path / f"{number}.npy"
        np.save(path, np.random.default_rng(number).normal(100, 20, (90, 110)))
        found.append(path)
    return found


def assert_same_bits(a: list[SceneStatistics], b: list[SceneStatistics]) -> None:
    for one, other in zip(a, b, strict=True):
        assert one.mean_dn == other.mean_dn
        assert one.products_dn2.tobytes() == other.products_dn2.tobytes()
        assert one.pixels.tobytes() == other.pixels.tobytes()


def test_a_cell_holds_what_the_image_gives(paths: list[Path]) -> None:
    [cell] = sweep_images(paths[:1], load, PLAN)
    expected = scene_artefact(load(paths[0]), PLAN.scenario, "matched", 1.4, 2)
    np.testing.assert_array_equal(cell.artefact(1, 1).products_dn2, expected.products_dn2)
    np.testing.assert_array_equal(cell.artefact(1, 1).pixels, expected.pixels)
    assert cell.mean_dn == load(paths[0]).mean()


def test_finished_cells_are_not_measured_again(paths: list[Path], tmp_path: Path) -> None:
    results = tmp_path / "cells.jsonl"
    first = sweep_images(paths, load, PLAN, results=results)
    seen: list[int] = []
    again = sweep_images(paths, refuse, PLAN, results=results, progress=seen.append)
    assert_same_bits(first, again)
    assert seen == [5]


def test_a_killed_sweep_resumes_where_it_was(paths: list[Path], tmp_path: Path) -> None:
    results = tmp_path / "cells.jsonl"
    whole = sweep_images(paths, load, PLAN, results=results)
    lines = results.read_bytes().splitlines(keepends=True)
    results.write_bytes(b"".join(lines[:2]) + lines[2][:100])  # killed while it wrote
    seen: list[int] = []
    assert_same_bits(whole, sweep_images(paths, load, PLAN, results=results, progress=seen.append))
    assert seen == [2, 3, 4, 5]
    assert len(results.read_bytes().splitlines()) == 5


def test_another_plan_is_measured_anew(paths: list[Path], tmp_path: Path) -> None:
    results = tmp_path / "cells.jsonl"
    sweep_images(paths[:1], load, PLAN, results=results)
    other = SweepPlan(scenario=PLAN.scenario, models=("bicubic",), zooms=(1.4,), tiles_per_side=1)
    [cell] = sweep_images(paths[:1], load, other, results=results)
    assert cell.products_dn2.shape == (1, 1, 1, 9, 17)


def test_few_images_are_cut_into_tiles() -> None:
    assert [tiles_per_side(count) for count in (1, 2, 4, 15, 16, 5000)] == [4, 3, 2, 2, 1, 1]


def test_a_small_image_and_a_broken_results_file_are_told_by_name(tmp_path: Path) -> None:
    path = tmp_path / "small.npy"
    np.save(path, np.ones((12, 12)))
    with pytest.raises(AnalysisError) as too_small:
        sweep_images([path], load, PLAN)
    assert str(path) in str(too_small.value)
    results = tmp_path / "cells.jsonl"
    results.write_text("{}\n")
    with pytest.raises(ResultsFileError) as broken:
        sweep_images([path], load, PLAN, results=results)
    assert broken.value.source == str(results)
    missing = tmp_path / "none.npy"
    with pytest.raises(ResultsFileError) as unreadable:
        sweep_images([missing], load, PLAN)
    assert unreadable.value.source == str(missing)


@pytest.mark.slow
def test_two_processes_give_the_same_bits(paths: list[Path]) -> None:
    assert_same_bits(
        sweep_images(paths, load, PLAN),
        sweep_images(paths, load, PLAN, workers=SweepWorkers(count=2)),
    )


CLUSTER = """
import os, signal, sys, threading, time
from pathlib import Path
from distributed import LocalCluster
from analysis.detectability.sweep import SweepWorkers, sweep_images
from tests.analysis.detectability.test_sweep import PLAN, assert_same_bits, load

def slow_load(path):
    time.sleep(0.1)
    return load(path)

def main():
    paths = [Path(name) for name in sys.argv[1:]]
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        killed = []
        def kill_one(done):
            if done == 1 and not killed:
                [worker, _] = cluster.workers.values()
                killed.append(worker.pid)
                os.kill(worker.pid, signal.SIGKILL)
        found = sweep_images(
            paths, slow_load, PLAN,
            workers=SweepWorkers(scheduler=cluster.scheduler_address), progress=kill_one,
        )
        assert killed
    assert_same_bits(found, sweep_images(paths, load, PLAN))
    print("same bits")

if __name__ == "__main__":
    main()
"""


@pytest.mark.slow
def test_a_cluster_of_which_a_worker_is_killed_gives_the_same_bits(
    paths: list[Path], tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    script = tmp_path / "cluster_run.py"
    script.write_text(CLUSTER)
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, str(script), *map(str, paths)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        env={"PYTHONPATH": str(root), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
        cwd=tmp_path,
    )
    assert "same bits" in done.stdout, done.stderr[-3000:]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_scheduler_that_does_not_answer_is_one_line(
    paths: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("analysis.detectability.sweep._CONNECT_S", 1)
    with pytest.raises(AnalysisError) as refused:
        sweep_images(paths, load, PLAN, workers=NOBODY)
    assert isinstance(refused.value.__cause__, OSError)
    assert str(NOBODY.scheduler) in str(refused.value)


def test_without_dask_the_extra_is_named(
    paths: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(AnalysisError) as refused:
        sweep_images(paths, load, PLAN, workers=NOBODY)
    assert isinstance(refused.value.__cause__, ImportError)
    assert "pip install 'standoff[cluster]'" in str(refused.value)
