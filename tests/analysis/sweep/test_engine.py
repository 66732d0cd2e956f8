from dataclasses import replace
from pathlib import Path

import pytest

from analysis.errors import SweepError
from analysis.sweep.engine import SweepOptions, run_sweep
from analysis.sweep.manifest import Manifest
from analysis.sweep.shards import GROUPS, Layout, Shard, ShardDone, blocks_of
from tests.analysis.sweep.hashing import Hashing, photographs


class Never(Hashing):
    def __call__(self, shard: Shard) -> ShardDone:
        raise AssertionError(f"{shard} is done again")


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
        first = run_sweep(manifest, work, progress=seen.append)
        assert (first.images, first.found_done, first.refused) == (200, 0, 0)
        assert first.notes == ("seen",)
        assert seen == sorted(set(seen))
        assert seen[-1] == 200
        # Nobody is asked for what is done.
        nobody = SweepOptions(scheduler="tcp://127.0.0.1:1")
        again = run_sweep(manifest, Never(work.folder), nobody)
    assert (again.images, again.found_done) == (200, 200)


def test_parts_together_are_the_whole(paths: list[Path], work: Hashing) -> None:
    with Manifest(paths, work.state) as manifest:
        counts = [run_sweep(manifest, work, SweepOptions(part=(k, 3))).images for k in (3, 1, 2)]
        assert sum(counts) == 200
        assert min(counts) > 40
        assert run_sweep(manifest, Never(work.folder)).found_done == 200


def test_a_changed_photograph_and_other_settings_are_done_anew(
    paths: list[Path], work: Hashing
) -> None:
    with Manifest(paths, work.state) as manifest:
        run_sweep(manifest, work)
        assert run_sweep(manifest, replace(work, settings="other")).found_done == 0
    paths[7].write_bytes(b"longer than before")
    with Manifest(paths, work.state) as manifest:
        summary = run_sweep(manifest, work)
    assert 180 < summary.found_done < 200


def test_what_cannot_be_done_is_listed_and_the_rest_is_done(
    paths: list[Path], work: Hashing
) -> None:
    for path in paths[20:40]:
        path.write_bytes(b"x")
    paths[41].unlink()
    with Manifest(paths, work.state) as manifest:
        summary = run_sweep(manifest, work)
        assert (summary.images, summary.refused) == (179, 21)
        assert len(summary.refused_lines) == 10
        assert summary.refused_list is not None
        listed = summary.refused_list.read_text().splitlines()
        assert sorted(listed) == [f"{path}: refused" for path in [*paths[20:40], paths[41]]]
        assert tuple(listed[:10]) == summary.refused_lines
        assert run_sweep(manifest, Never(work.folder)).refused == 21
        with pytest.raises(SweepError):
            run_sweep(manifest, work, SweepOptions(strict=True))
    for path in paths[20:42]:
        path.write_bytes(b"mended")
    with Manifest(paths, work.state) as manifest:
        assert run_sweep(manifest, work).refused_list is None
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
def test_many_photographs_make_64_groups_or_more_and_shards_of_64_at_most(count: int) -> None:
    layout = Layout.of(count)
    assert layout.shard_bits >= layout.block_bits >= 6
    assert count / 2**layout.shard_bits <= 64
    assert count / 2**layout.block_bits <= 16 * 64


def test_each_of_few_photographs_is_a_shard() -> None:
    assert {Layout.of(count).shard_bits for count in (1, 16, 64, 127)} == {64}


def test_groups_are_even_and_shards_of_a_block_share_theirs(
    paths: list[Path], tmp_path: Path
) -> None:
    with Manifest(paths, tmp_path) as manifest:
        blocks = list(blocks_of(manifest, "key"))
    groups = [block[0].group for block in blocks]
    assert groups == sorted(groups)
    assert all(shard.group == block[0].group for block in blocks for shard in block)
    assert max(groups) < GROUPS
    # The names hold a random folder: how many groups they fall into varies.
    assert len(set(groups)) > 45
