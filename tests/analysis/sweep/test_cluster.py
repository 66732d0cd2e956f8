import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask
import pytest
from distributed import Client, LocalCluster

import standoff
from analysis.errors import SweepError
from analysis.sweep import (
    Batch,
    Commit,
    Manifest,
    SweepItem,
    SweepOptions,
    batch_number,
    cluster,
    run_sweep,
)
from tests.analysis.sweep.hashing import Hashing, answers, photographs

pytestmark = pytest.mark.slow


def work_in(folder: Path, delay_s: float = 0.0) -> Hashing:
    folder.mkdir()
    return Hashing(folder, delay_s=delay_s)


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return photographs(tmp_path_factory.mktemp("sweep") / "photographs", 200)


@pytest.fixture(scope="module")
def expected(paths: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict[Path, str]:
    work = work_in(tmp_path_factory.mktemp("sweep") / "expected")
    with Manifest(paths, work.state) as manifest:
        run_sweep(manifest, work)
        return answers(manifest, work)


@pytest.fixture(scope="module")
def local() -> Iterator[Any]:
    """One single-threaded worker in a process of its own."""
    with (
        # One that is killed starts again, however long that takes on a busy machine.
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1 hour"}),
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
        ) as found,
    ):
        yield found


def test_a_single_threaded_worker_does_the_work_and_the_client_none(
    paths: list[Path], expected: dict[Path, str], local: Any, tmp_path: Path
) -> None:
    work = work_in(tmp_path / "state")
    with Manifest(paths, work.state) as manifest:
        found, _ = run_sweep(manifest, work, SweepOptions(scheduler=local.scheduler_address))
        assert answers(manifest, work) == expected
    assert found.images == 200
    assert work.workers() == {worker.pid for worker in local.workers.values()}
    assert os.getpid() not in work.workers()


def test_two_processes_give_the_same_answers(
    paths: list[Path], expected: dict[Path, str], tmp_path: Path
) -> None:
    work = work_in(tmp_path / "state", delay_s=0.01)
    with Manifest(paths, work.state) as manifest:
        assert run_sweep(manifest, work, SweepOptions(workers=2))[0].images == 200
        assert answers(manifest, work) == expected
    assert len(work.workers() - {os.getpid()}) == 2


@pytest.mark.parametrize("unseen", ["state", "photographs"])
def test_a_worker_that_does_not_see_what_is_here_is_named(
    unseen: str, local: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photographs(tmp_path / "photographs", 3)
    (tmp_path / "state").mkdir()
    monkeypatch.chdir(tmp_path)
    # Each process sees its own working folder there.
    folders = {name: tmp_path / name for name in ("state", "photographs")}
    folders[unseen] = Path("/proc/self/cwd") / unseen
    work = Hashing(folders["state"])
    with (
        Manifest(folders["photographs"].iterdir(), work.state) as manifest,
        pytest.raises(SweepError) as unfit,
    ):
        run_sweep(manifest, work, SweepOptions(scheduler=local.scheduler_address))
    assert f"{local.workers[0].worker_address} on {socket.gethostname()} does not see" in str(
        unfit.value
    )
    assert str(folders[unseen]) in str(unfit.value)
    assert not list(work.state.glob("*.records"))


def test_a_photograph_that_vanishes_meanwhile_is_refused(local: Any, tmp_path: Path) -> None:
    paths = photographs(tmp_path / "photographs", 3)
    work = work_in(tmp_path / "state")
    with Manifest(paths, work.state) as manifest:
        paths[1].unlink()
        found, _ = run_sweep(manifest, work, SweepOptions(scheduler=local.scheduler_address))
    assert (found.images, found.refused_lines) == (2, (f"{paths[1]}: refused",))


def test_a_worker_of_another_version_is_named(
    paths: list[Path], local: Any, tmp_path: Path
) -> None:
    def become(version: str) -> None:
        import standoff

        standoff.__version__ = version

    work = work_in(tmp_path / "state")
    with Client(local.scheduler_address, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        client.run(become, "0.0.1")
        with Manifest(paths, work.state) as manifest, pytest.raises(SweepError) as unfit:
            run_sweep(manifest, work, SweepOptions(scheduler=local.scheduler_address))
        client.run(become, standoff.__version__)
    assert str(unfit.value) == (
        f"the Dask worker {local.workers[0].worker_address} on {socket.gethostname()} has standoff "
        f"0.0.1; it is {standoff.__version__} here"
    )


def test_a_scheduler_without_workers_and_none_at_all_are_one_line(
    paths: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.5)
    work = work_in(tmp_path / "state")
    with (
        Manifest(paths, work.state) as manifest,
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty,  # type: ignore[no-untyped-call]
    ):
        with pytest.raises(SweepError) as no_workers:
            run_sweep(manifest, work, SweepOptions(scheduler=empty.scheduler_address))
        with pytest.raises(SweepError) as nobody:
            run_sweep(manifest, work, SweepOptions(scheduler="tcp://127.0.0.1:1"))
    assert f"{empty.scheduler_address} has no workers after 0.5 s" in str(no_workers.value)
    assert "no Dask scheduler answers at tcp://127.0.0.1:1" in str(nobody.value)
    assert not work.workers()


@dataclass(frozen=True)
class Deadly(Hashing):
    """Kills the worker that does the batch of one photograph, as too large an image would."""

    photograph: Path = Path()

    def do(self, batch: Batch, commit: Commit) -> None:
        if self.photograph in {item.path for item in batch.items}:
            os.kill(os.getpid(), signal.SIGKILL)
        super().do(batch, commit)


def test_a_batch_that_kills_every_worker_is_named_when_the_others_are_done(
    paths: list[Path], expected: dict[Path, str], local: Any, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    state.mkdir()
    with Manifest(paths, state) as manifest:
        first = next(iter(manifest))
        work = Deadly(state, photograph=first.path)
        with pytest.raises(SweepError) as deadly:
            run_sweep(manifest, work, SweepOptions(scheduler=local.scheduler_address))
        done = answers(manifest, work)
    assert "4 workers died" in str(deadly.value)
    assert f"photographs from {first.path} on" in str(deadly.value)
    batch = batch_number(first.hash, len(expected))
    assert expected.keys() - done.keys() == {
        path
        for path in expected
        if batch_number(SweepItem.on_disk(path).hash, len(expected)) == batch
    }


@dataclass(frozen=True)
class KillsTwice(Hashing):
    """Once a batch is committed, kills the worker that does the next, and then one more."""

    def do(self, batch: Batch, commit: Commit) -> None:
        if list(self.folder.glob("*.records")):
            for number in range(2):
                try:
                    (self.folder / f"{number}.killed").touch(exist_ok=False)
                except FileExistsError:
                    continue
                os.kill(os.getpid(), signal.SIGKILL)
        super().do(batch, commit)


def test_killed_workers_that_start_slowly_are_waited_for(
    paths: list[Path], expected: dict[Path, str], tmp_path: Path
) -> None:
    state = tmp_path / "state"
    state.mkdir()
    work = KillsTwice(state)
    with (
        # Every start takes longer than this.
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1 ms"}),
        Manifest(paths, state) as manifest,
    ):
        assert run_sweep(manifest, work, SweepOptions(workers=2))[0].images == 200
        assert answers(manifest, work) == expected
    assert len(list(state.glob("*.killed"))) == 2


def test_when_no_worker_comes_back_the_sweep_ends_and_keeps_what_was_done(
    paths: list[Path],
    expected: dict[Path, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shorter = {"distributed.deploy.lost-worker-timeout": "1 ms"}
    assert shorter.keys() <= cluster._CONFIG.keys()
    monkeypatch.setattr(cluster, "_CONFIG", cluster._CONFIG | shorter)
    state = tmp_path / "state"
    state.mkdir()
    work = KillsTwice(state)
    with Manifest(paths, state) as manifest:
        with pytest.raises(SweepError) as gone:
            run_sweep(manifest, work, SweepOptions(workers=2, workers_gone_s=1))
        before = len(answers(manifest, work))
        summary, _ = run_sweep(manifest, Hashing(state))  # which kills nobody
        assert (summary.images, summary.found_done) == (200, before)
        assert answers(manifest, work) == expected
    assert "the workers are gone and none came back within 1 s" in str(gone.value)
    assert 0 < before < len(expected)


def test_a_cluster_of_others_whose_workers_are_all_gone_is_not_waited_for(
    paths: list[Path], expected: dict[Path, str], tmp_path: Path
) -> None:
    """Such a scheduler knows none of our settings, and keeps what waits for a worker for ever."""
    work = work_in(tmp_path / "state", delay_s=0.05)
    with (
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
        ) as other,
        Manifest(paths, work.state) as manifest,
    ):

        def send_home() -> None:
            while not list(work.state.glob("*.records")):
                time.sleep(0.01)
            other.scale(0)

        sending = threading.Thread(target=send_home)
        sending.start()
        options = SweepOptions(scheduler=other.scheduler_address, workers_gone_s=1)
        with pytest.raises(SweepError, match="none came back within 1 s"):
            run_sweep(manifest, work, options)
        sending.join()
        assert 0 < len(answers(manifest, work)) < len(expected)
