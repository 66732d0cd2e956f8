"""Records hold whatever is killed, whoever writes: torn tails, several writers, merges, files."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from analysis.errors import ResultsFileError
from analysis.sweep import (
    Batch,
    Commit,
    Manifest,
    Record,
    Records,
    Stored,
    SweepItem,
    SweepOptions,
    SweepWork,
    run_sweep,
)
from analysis.sweep._work import do_batch
from tests.analysis.sweep.hashing import Hashing, answers, photographs

PATHS = [Path(f"/nowhere/{number}.png") for number in range(150)]
TOTAL = sum(number for number in range(150) if number % 10)


@dataclass(frozen=True)
class Adding(SweepWork):
    """Adds up the numbers that photographs are named by, and refuses every tenth."""

    is_merged: ClassVar[bool] = True

    folder: Path
    key: str = "adding"

    @property
    def state(self) -> Path:
        return self.folder

    def do(self, batch: Batch, commit: Commit) -> None:
        numbers = {item: int(item.path.stem) for item in batch.items}
        records = [
            Record(items=(item,), rows=({},), refused=f"{number}")
            for item, number in numbers.items()
            if number % 10 == 0
        ]
        added = [item for item, number in numbers.items() if number % 10]
        if added:
            data = str(sum(numbers[item] for item in added)).encode()
            records.append(Record(items=added, rows=[{}] * len(added), data=data))
        commit(records)

    def merged(self, parts: Sequence[Stored]) -> bytes:
        return str(sum(int(part.read()) for part in parts)).encode()


def added(records: Records) -> tuple[int, int]:
    """Sum of the numbers, and how many photographs it is of."""
    found = [(int(stored.read()), images) for _, images, _, stored in records.merged()]
    return sum(one for one, _ in found), sum(images for _, images in found)


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("part"), st.integers(1, 4)),
        st.tuples(st.just("another writer"), st.integers(0, 60)),
        st.tuples(st.just("merge"), st.just(0)),
        st.tuples(st.just("tidy"), st.just(0)),
        st.tuples(st.just("fewer photographs"), st.integers(128, 149)),
        st.tuples(st.just("torn"), st.integers(0, 1 << 20)),
    ),
    max_size=6,
)


@settings(deadline=None, max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(STEPS)
def test_whatever_happens_each_photograph_counts_once(steps: list[tuple[str, int]]) -> None:
    with TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)  # nothing is cut off the power here
        work = Adding(Path(name))
        for step, number in steps:
            take_step(work, step, number)
        with Manifest(PATHS, work.state) as manifest:
            summary, records = run_sweep(manifest, work)
            assert (summary.images, summary.refused) == (135, 15)
            assert added(records) == (TOTAL, 135)
            records.tidy()
            assert added(records) == (TOTAL, 135)
        with Manifest(PATHS, work.state) as manifest:
            again, records = run_sweep(manifest, work)
            assert again.found_done == 150
            assert added(records) == (TOTAL, 135)
        assert len(list(work.state.glob("*.records"))) == 1


def take_step(work: Adding, step: str, number: int) -> None:
    if step == "torn":
        segments = sorted(work.state.glob("*.records"))
        if segments:
            segment = segments[number % len(segments)]
            data = segment.read_bytes()
            segment.write_bytes(data[: number % (len(data) + 1)])
        return
    paths = PATHS[:number] if step == "fewer photographs" else PATHS
    with Manifest(paths, work.state) as manifest:
        if step in ("part", "fewer photographs"):
            part = (number, 4) if step == "part" else (1, 1)
            run_sweep(manifest, work, SweepOptions(part=part))
            return
        records = Records(manifest, work)
        if step == "merge":
            records.merge()
        elif step == "tidy":
            records.tidy()
        else:  # its client is killed before it hears of a batch
            for *_, batch in list(records.batches())[number:]:
                if batch.items:
                    do_batch(work, batch)


@given(cut=st.floats(0, 1))
@settings(deadline=None, max_examples=10)
def test_what_is_before_a_torn_tail_is_found_and_the_rest_done_again(cut: float) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        paths = photographs(folder / "photographs", 12)
        work = Hashing(folder)
        with Manifest(paths, folder) as manifest:
            run_sweep(manifest, work)
            expected = answers(manifest, work)
            [segment] = folder.glob("*.records")
            data = segment.read_bytes()
            at = round(cut * len(data))
            segment.write_bytes(data[:at])
            whole = data[:at].count(b"record/1 ")
            found = answers(manifest, work)
            assert whole - 1 <= len(found) <= whole
            assert found.items() <= expected.items()
            summary, _ = run_sweep(manifest, work)
            assert summary.found_done == len(found)
            assert answers(manifest, work) == expected


@dataclass(frozen=True)
class Writing(Hashing):
    """Writes a file for each photograph, of the same size with all settings."""

    killed_at: str = ""

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        name = f"{item.path.stem}.txt"
        (self.folder / name).write_text(self.settings)
        if item.path.stem == self.killed_at:
            raise KeyboardInterrupt
        row = {"sha256": self.settings}
        return Record(items=(item,), rows=(row,), files={name: len(self.settings)})


def test_an_answer_whose_file_others_wrote_over_is_none(tmp_path: Path) -> None:
    paths = photographs(tmp_path / "photographs", 5)
    state = tmp_path / "state"
    one, other = Writing(state, settings="one"), Writing(state, settings="two", killed_at="0003")
    with Manifest(paths, state) as manifest:
        run_sweep(manifest, one)
        assert len(answers(manifest, one)) == 5
        with pytest.raises(KeyboardInterrupt):
            run_sweep(manifest, other)
        written = {path for path in paths if (state / f"{path.stem}.txt").read_text() == "two"}
        assert answers(manifest, one).keys() == set(paths) - written
        run_sweep(manifest, one)
        assert {path.read_text() for path in state.glob("*.txt")} == {"one"}
        (state / "0002.txt").write_text("longer")
        (state / "0004.txt").unlink()
        assert answers(manifest, one).keys() == set(paths) - {paths[2], paths[4]}


@dataclass(frozen=True)
class Counting(Hashing):
    """Counts to three for each photograph, one further with each run."""

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        count = int(batch.earlier(item) or b"0") + 1
        row = {"sha256": str(count)}
        data = str(count).encode()
        return Record(items=(item,), rows=(row,), data=data, is_final=count == 3)


def test_what_is_not_final_counts_in_its_run_and_the_next_goes_on_from_it(tmp_path: Path) -> None:
    paths = photographs(tmp_path / "photographs", 4)
    work = Counting(tmp_path / "state")
    with Manifest(paths, work.state) as manifest:
        for run in range(1, 5):
            summary, records = run_sweep(manifest, work)
            assert summary.found_done == (4 if run == 4 else 0)
            assert {one.row["sha256"] for one in records.answers()} == {str(min(run, 3))}


def test_records_that_vanish_meanwhile_are_told_by_name(tmp_path: Path) -> None:
    work = Hashing(tmp_path)
    with Manifest(photographs(tmp_path / "photographs", 3), tmp_path) as manifest:
        _, records = run_sweep(manifest, work)
        [segment] = tmp_path.glob("*.records")
        segment.unlink()
        with pytest.raises(ResultsFileError, match="vanished or was damaged"):
            list(records.answers())
