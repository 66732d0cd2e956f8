"""Has batches done by Dask workers, on this machine or elsewhere; the client does none itself."""

import gc
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

import cloudpickle
import dask
from distributed import Client, KilledWorker, LocalCluster, as_completed
from distributed.client import FutureCancelledError
from distributed.scheduler import NoWorkerError

from acquisition.remote_files import is_own_memory, is_url
from analysis.errors import SweepError
from analysis.sweep._work import Batch, SweepWork, Written

_CONNECT_S = 10
_THREADS_ASKED_EVERY_S = 2.0
_BATCHES_A_THREAD = 2
"""One that is done and one that waits: what the scheduler holds does not grow with the sweep."""

_COLLECTED_EVERY = 50
"""Batches, 10 kB each, that Dask leaves in circles of references until they are collected."""

_RESULT_S = 10.0
"""Longest wait for a result before the workers are looked for."""

_MARKER = "sweep.id"

_SAME = ("standoff", "numpy", "scipy", "cv2")
"""Packages of which another version may give other bits."""

_CONFIG = {
    # What a scheduler or worker remembers of the past stays small.
    "distributed.admin.low-level-log-length": 100,
    "distributed.admin.log-length": 100,
    "distributed.admin.system-monitor.log-length": 100,
    "distributed.diagnostics.computations.max-history": 1,
    "distributed.worker.profile.enabled": False,
    # A worker that is killed starts again, which on a busy machine takes longer than the 15 s after
    # which Dask gives it up for good. If none comes back, the sweep ends by its own clock.
    "distributed.deploy.lost-worker-timeout": "1 hour",
    # The result of a worker that was killed meanwhile is asked for in vain so long, by default
    # 30 s; a worker that lives is reached at once, however busy.
    "distributed.comm.timeouts.connect": "5 s",
}

Dask = Any
"""An object of Dask, which has no types."""


@contextmanager
def local_workers(count: int) -> Iterator[str]:
    """Start so many single-threaded processes; yields the address of their scheduler."""
    with (
        dask.config.set(_CONFIG),
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address=None,
            silence_logs=logging.CRITICAL,
            # A batch takes what it takes; Dask would end a worker for it.
            memory_limit=0,
        ) as cluster,
    ):
        yield cluster.scheduler_address


def done_by_workers(
    batches: Iterator[Batch], work: SweepWork, scheduler: str, gone_s: float
) -> Iterator[tuple[Batch, list[Written]]]:
    """Yield each batch when a worker has done it, in any order; few are under way at a time.

    Every worker is asked, before every batch, for its versions and whether it sees the folder of
    the state and the photographs: workers may join at any time.

    Parameters
    ----------
    batches, work
        What is to be done.
    scheduler
        Address of a Dask scheduler.
    gone_s
        Longest time without any worker.

    Raises
    ------
    SweepError
        If no scheduler answers, it has no workers or they are all gone, a worker is not fit, or
        several were killed over one batch.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_is_no_leftover)
    try:
        client: Dask = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise SweepError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError as error:
            raise SweepError(
                f"the Dask scheduler at {scheduler} has no workers after {_CONNECT_S} s; start "
                f"some: dask worker {scheduler}"
            ) from error
        yield from _Workers(client, scheduler, work, gone_s).done(batches)


class _Workers:
    """The workers of one scheduler, and the batches that are under way."""

    def __init__(self, client: Dask, scheduler: str, work: SweepWork, gone_s: float) -> None:
        self._client = client
        self._scheduler = scheduler
        self._work = work
        self._gone_s = gone_s
        self._seen_s = time.monotonic()
        self._run = f"standoff-batch-{uuid4().hex}"
        self._task = _batch_task()
        self._asked = {
            "versions": {name: import_module(name).__version__ for name in _SAME},
            "marker": os.fspath(work.state / _MARKER),
            "sweep": _marked(work.state / _MARKER),
        }
        self._sent: dict[Any, Batch] = {}
        self._threads = 0
        self._threads_asked_s = -_THREADS_ASKED_EVERY_S

    def done(self, batches: Iterator[Batch]) -> Iterator[tuple[Batch, list[Written]]]:
        """See `done_by_workers`."""
        under_way: Dask = as_completed(loop=self._client.loop)  # type: ignore[no-untyped-call]
        suspects = []
        for batch in islice(batches, self._window()):
            under_way.add(self._submitted(batch))
        for number, future in enumerate(self._completed(under_way), 1):
            if number % _COLLECTED_EVERY == 0:
                gc.collect()
            batch = self._sent.pop(future.key)
            try:
                done = self._result(future, batch)
            except KilledWorker:
                # Perhaps another batch of the same workers was at fault: done alone, at the end.
                suspects.append(batch)
            else:
                yield batch, done
            future.release()
            for following in islice(batches, max(0, self._window() - len(self._sent))):
                under_way.add(self._submitted(following))
        for batch in suspects:
            try:
                yield batch, self._result(self._submitted(batch), batch)
            except KilledWorker as error:
                raise SweepError(
                    f"{error.allowed_failures + 1} workers died, the last on "
                    f"{error.last_worker.host}, over the {len(batch.items)} photographs from "
                    f"{batch.items[0].path} on: too little memory?"
                ) from error

    def _completed(self, under_way: Dask) -> Iterator[Dask]:
        """Yield batches as they end; Dask alone would wait for ever for a worker."""
        while not under_way.is_empty():
            while not under_way.has_ready():
                with under_way.thread_condition:
                    under_way.thread_condition.wait(0.1)
                self._require_workers()
            yield next(under_way)

    def _require_workers(self) -> None:
        """End the sweep if there has been no worker for too long."""
        with suppress(OSError):  # a scheduler that is gone cancels what is under way
            self._look_for_workers()
        if time.monotonic() - self._seen_s > self._gone_s:
            raise _workers_gone(self._gone_s)

    def _look_for_workers(self) -> None:
        """Count the workers' threads, once in a while."""
        now_s = time.monotonic()
        if now_s - self._threads_asked_s < _THREADS_ASKED_EVERY_S:
            return
        self._threads = sum(self._client.nthreads().values())
        self._threads_asked_s = time.monotonic()
        if self._threads:
            self._seen_s = self._threads_asked_s

    def _submitted(self, batch: Batch, *, is_looked_for: bool = True) -> Dask:
        if any(is_own_memory(item.path) for item in batch.items):
            raise SweepError(
                "memory:// is this process's own, and other processes cannot see it; work "
                "without --workers and --scheduler"
            )
        there = [
            (os.fspath(item.path), item.size_bytes)
            for item in batch.items
            if item.is_there and is_looked_for and not is_url(item.path)
        ]
        future = self._client.submit(
            self._task,
            self._asked | {"files": there},
            cloudpickle.dumps((self._work, batch)),
            key=(self._run, batch.number, len(there)),
            pure=False,
        )
        self._sent[future.key] = batch
        return future

    def _result(self, future: Dask, batch: Batch) -> list[Written]:
        try:
            kind, value = self._outcome(future)
        except FutureCancelledError as error:
            raise SweepError(
                f"the Dask scheduler at {self._scheduler} ended; run the same command again"
            ) from error
        except NoWorkerError as error:
            raise _workers_gone(error.timeout) from error
        if kind == "unfit":
            raise SweepError(value)
        if kind == "unseen":
            self._require_unseen_here(value)
            # Gone here as well: the work refuses it.
            return self._result(self._submitted(batch, is_looked_for=False), batch)
        done: list[Written] = value
        return done

    def _outcome(self, future: Dask) -> tuple[str, Any]:
        """Wait for what a worker says; one may have died before it handed that over."""
        while True:
            try:
                outcome: tuple[str, Any] = future.result(timeout=min(_RESULT_S, self._gone_s))
            except TimeoutError:
                if future.status == "error":  # of the work itself
                    raise
                self._require_workers()
            else:
                return outcome

    def _require_unseen_here(self, unseen: tuple[str, int, str]) -> None:
        path, size_bytes, worker = unseen
        try:
            is_here = Path(path).stat().st_size == size_bytes
        except OSError:
            is_here = False
        if is_here:
            raise SweepError(
                f"the Dask worker {worker} does not see {path} as it is here: all workers need "
                "the photographs under the same paths"
            )

    def _window(self) -> int:
        self._look_for_workers()
        return _BATCHES_A_THREAD * max(self._threads, 1)


def _workers_gone(after_s: float) -> SweepError:
    return SweepError(
        f"the workers are gone and none came back within {after_s:.0f} s: too little memory? "
        "What they did is kept; run the same command again, with fewer workers or others"
    )


def _is_no_leftover(record: logging.LogRecord) -> bool:
    """Whether it is something else than what Dask leaves of a wait that was broken off."""
    return record.exc_info is None or getattr(record.exc_info[0], "__name__", "") != "AllExit"


def _marked(marker: Path) -> str:
    """Write once what tells this folder from another of the same name on another machine."""
    try:
        with marker.open("x", encoding="ascii") as file:
            file.write(uuid4().hex)
    except FileExistsError:
        pass
    return marker.read_text("ascii")


def _batch_task() -> Callable[[dict[str, Any], bytes], tuple[str, Any]]:
    """Return what a worker runs; being local, it is sent as code, to any version of ours."""

    def do_batch(asked: dict[str, Any], payload: bytes) -> tuple[str, Any]:
        import os
        import pickle
        import socket
        from importlib import import_module

        from distributed import get_worker

        worker = f"{get_worker().address} on {socket.gethostname()}"
        for name, version in asked["versions"].items():
            try:
                own = import_module(name).__version__
            except ImportError:
                return "unfit", f"the Dask worker {worker} has no {name}; it needs {version}"
            if own != version:
                return "unfit", f"the Dask worker {worker} has {name} {own}; it is {version} here"
        try:
            with open(asked["marker"], encoding="ascii") as file:  # noqa: PTH123  no imports
                sweep = file.read()
        except OSError:
            sweep = ""
        if sweep != asked["sweep"]:
            folder = os.path.dirname(asked["marker"])  # noqa: PTH120
            return "unfit", (
                f"the Dask worker {worker} does not see the folder {folder}: all workers need it "
                "under the same path"
            )
        for path, size_bytes in asked["files"]:
            try:
                seen_bytes = os.stat(path).st_size  # noqa: PTH116
            except OSError:
                seen_bytes = -1
            if seen_bytes != size_bytes:
                return "unseen", (path, size_bytes, worker)
        from analysis.sweep._work import do_batch as do_batch_here
        from analysis.sweep.worker_process import prepare_process

        prepare_process()
        work, batch = pickle.loads(payload)  # noqa: S301  from the client alone
        return "done", do_batch_here(work, batch)

    return do_batch
