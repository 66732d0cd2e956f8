from dataclasses import replace
from pathlib import Path

import pytest

from analysis.errors import SweepError
from analysis.sweep import Batch, Commit, Manifest, SweepOptions, batch_number, group_of, run_sweep
from tests.analysis.sweep.hashing import Hashing, answers, photographs


class Never(Hashing):
    def do(self, batch: Batch, commit: Commit) -> None:
        raise AssertionError(f"{batch} is done again")


@pytest.fixture
def paths(tmp_path: Path) -> list[Path]:
    return photographs(tmp_path / "photographs", 200)


@pytest.fixture
def work(tmp_path: Path) -> Hashing:
    state = tmp_path / "state"
    state.mkdir()
    return Hashing(state)


def test_each_photograph_is_done_once_and_found_by_the_next_run(
    paths: list[Path], work: Hashing
) -> None:
    seen: list[int] = []
    with Manifest(paths, work.state) as manifest:
        first, _ = run_sweep(manifest, work, progress=seen.append)
        assert (first.images, first.found_done, first.refused) == (200, 0, 0)
        assert first.notes == ("seen",)
        assert seen == sorted(set(seen))
        assert seen[-1] == 200
        # Nobody is asked for what is done.
        nobody = SweepOptions(scheduler="tcp://127.0.0.1:1")
        again, _ = run_sweep(manifest, Never(work.folder), nobody)
    assert (again.images, again.found_done) == (200, 200)
    assert again.notes == ("seen",)


def test_parts_together_are_the_whole(paths: list[Path], work: Hashing) -> None:
    with Manifest(paths, work.state) as manifest:
        counts = []
        for part in (3, 1, 2):
            summary, records = run_sweep(manifest, work, SweepOptions(part=(part, 3)))
            counts.append(summary.images)
            assert records.is_whole == (len(counts) == 3)
            assert len(list(records.answers())) == summary.images
        assert sum(counts) == 200
        assert min(counts) > 40
        assert run_sweep(manifest, Never(work.folder))[0].found_done == 200


def test_a_changed_photograph_and_other_settings_are_done_anew(
    paths: list[Path], work: Hashing
) -> None:
    with Manifest(paths, work.state) as manifest:
        run_sweep(manifest, work)
        assert run_sweep(manifest, replace(work, settings="other"))[0].found_done == 0
    paths[7].write_bytes(b"longer than before")
    with Manifest(paths, work.state) as manifest:
        assert run_sweep(manifest, work)[0].found_done == 199


def test_what_cannot_be_done_is_listed_and_the_rest_is_done(
    paths: list[Path], work: Hashing
) -> None:
    for path in paths[20:40]:
        path.write_bytes(b"x")
    paths[41].unlink()
    with Manifest(paths, work.state) as manifest:
        summary, _ = run_sweep(manifest, work)
        assert (summary.images, summary.refused) == (179, 21)
        assert len(summary.refused_lines) == 10
        assert summary.refused_list is not None
        listed = summary.refused_list.read_text().splitlines()
        assert sorted(listed) == [f"{path}: refused" for path in [*paths[20:40], paths[41]]]
        assert tuple(listed[:10]) == summary.refused_lines
        assert run_sweep(manifest, Never(work.folder))[0].refused == 21
        with pytest.raises(SweepError):
            run_sweep(manifest, work, SweepOptions(strict=True))
    for path in paths[20:42]:
        path.write_bytes(b"mended")
    with Manifest(paths, work.state) as manifest:
        assert run_sweep(manifest, work)[0].refused_list is None
        assert all(len(one) == 64 for one in answers(manifest, work).values())
    assert not summary.refused_list.exists()


def test_the_manifest_is_the_same_for_any_order_and_counts_a_path_once(
    paths: list[Path], tmp_path: Path
) -> None:
    with Manifest(paths, tmp_path) as one, Manifest([*paths[::-1], paths[3]], tmp_path) as other:
        assert list(one) == list(other)
        assert len(one) == len(other) == 200
        hashes = [item.hash for item in one]
        assert hashes == sorted(hashes)


@pytest.mark.parametrize("count", [128, 200, 383, 1000, 5000, 100_000, 1_000_000])
def test_many_photographs_make_64_groups_or_more_and_batches_of_64_at_most(count: int) -> None:
    batches = batch_number(2**64 - 1, count) + 1
    assert batches >= 64
    assert count / batches <= 64
    # No batch is of two groups.
    assert all(
        group_of(first) == group_of(first + 2**64 // batches - 1)
        for first in range(0, 2**64, 2**64 // min(batches, 4096))
    )


def test_each_of_few_photographs_is_a_batch() -> None:
    assert {batch_number(2**64 - 1, count) for count in (1, 16, 64, 127)} == {2**64 - 1}


@pytest.mark.parametrize(
    "name", ["0f.sums", "a.scores.npz", "0123456789abcdef.json", "0123456789abcdef-7.json"]
)
def test_a_folder_of_an_earlier_version_is_refused_with_the_remedy(
    work: Hashing, name: str
) -> None:
    (work.state / name).touch()
    with pytest.raises(SweepError) as refused:
        Manifest([], work.state)
    assert str(refused.value) == (
        f"{work.state} was written by an earlier version of standoff, and this version cannot "
        "continue from it; remove it, or name another --out"
    )
