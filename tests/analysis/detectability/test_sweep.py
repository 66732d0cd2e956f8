import hashlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from analysis.detectability import (
    ArtefactSums,
    ArtefactTiles,
    ArtefactWork,
    GaussianSignal,
    MeasuredPhotograph,
    Scenario,
    SceneImage,
    SweepPlan,
    SweepSums,
    d_primes,
    local_changes,
    scene_artefact,
    scene_sums,
    tiles_per_side,
)
from analysis.detectability._sweep import StoredSums, SummedPhotographs
from analysis.errors import AnalysisError, RefusedPhotographError, ResultsFileError
from analysis.sweep import Manifest, Records, Stored, SweepOptions, run_sweep
from simulation import GaussianPsf

PLAN = SweepPlan(
    scenario=Scenario(psf=GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8), window_px=5),
    models=("bicubic", "matched"),
    zooms=(1.0, 1.4),
    tiles_per_side=1,
)


def load(path: Path) -> SceneImage:
    try:
        grey_dn = np.asarray(np.load(path), dtype=np.float64)
    except (OSError, ValueError) as error:
        raise RefusedPhotographError(str(error)) from error
    return SceneImage(grey_dn=grey_dn, sha256=hashlib.sha256(path.read_bytes()).hexdigest())


def never(path: Path) -> SceneImage:
    raise AssertionError(f"{path} is measured again")


def scenes(folder: Path, count: int) -> list[Path]:
    folder.mkdir()
    paths = [folder / f"{number:04d}.npy" for number in range(count)]
    for number, path in enumerate(paths):
        np.save(path, np.random.default_rng(number).normal(100, 20, (40, 44)))
    return paths


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return scenes(tmp_path_factory.mktemp("sweep") / "few", 5)


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """So many that there are blocks of several shards: 128 of 2.3, in 64 blocks."""
    return scenes(tmp_path_factory.mktemp("sweep") / "many", 300)


def work_in(folder: Path, loads: Callable[[Path], SceneImage] = load) -> ArtefactWork:
    folder.mkdir(exist_ok=True)
    return ArtefactWork(plan=PLAN, load=loads, folder=folder)


@dataclass(frozen=True)
class Swept:
    """Counts and results of a sweep, read before its manifest is closed."""

    images: int
    found_done: int
    refused_lines: tuple[str, ...]
    bits: list[bytes]
    photographs: list[MeasuredPhotograph]
    artefacts: list[list[ArtefactTiles]]


def swept(
    paths: list[Path], work: ArtefactWork, options: SweepOptions | None = None, *, tidy: bool = True
) -> Swept:
    with Manifest(paths, work.folder) as manifest:
        summary, records = run_sweep(manifest, work, options)
        if tidy:
            records.tidy()
        sums = SweepSums(records)
        return Swept(
            images=summary.images,
            found_done=summary.found_done,
            refused_lines=summary.refused_lines,
            bits=bits(sums),
            photographs=list(sums.photographs()),
            artefacts=[sums.artefacts(model) for model in range(len(work.plan.models))],
        )


def bits(sums: SweepSums) -> list[bytes]:
    return [
        values.tobytes()
        for model in range(len(PLAN.models))
        for tiles in sums.artefacts(model)
        for values in (tiles.products_dn2, tiles.pixels)
    ]


@pytest.fixture(scope="module")
def expected(many: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Swept:
    return swept(many, work_in(tmp_path_factory.mktemp("sweep") / "expected"))


def test_few_photographs_are_tiles_of_their_own_in_the_order_of_their_names(
    few: list[Path], tmp_path: Path
) -> None:
    plan = replace(PLAN, tiles_per_side=2)
    found = swept(few, replace(work_in(tmp_path / "state"), plan=plan))
    parts = [
        scene_artefact(load(path).grey_dn, plan.scenario, "matched", 1.4, 2).products_dn2
        for path in few
    ]
    np.testing.assert_array_equal(found.artefacts[1][1].products_dn2, np.concatenate(parts))
    assert [one.path for one in found.photographs] == [str(path) for path in few]
    assert [one.mean_dn for one in found.photographs] == [load(path).grey_dn.mean() for path in few]


@pytest.mark.slow
def test_many_photographs_are_64_groups_whose_sum_is_theirs(
    many: list[Path], expected: Swept
) -> None:
    assert expected.images == 300
    own = [scene_sums(load(path).grey_dn, PLAN) for path in many]
    for model in range(2):
        for zoom, tiles in enumerate(expected.artefacts[model]):
            assert 60 <= len(tiles.pixels) <= 64  # of 64, e^-4.7 are empty
            each = [one.artefact(model, zoom) for one in own]
            # 300 additions in another order.
            np.testing.assert_allclose(
                tiles.products_dn2.sum(axis=0),
                sum(one.products_dn2[0] for one in each),
                rtol=1e-10,
                atol=1e-6,
            )
            assert tiles.pixels.sum() == sum(one.pixels.sum() for one in each)


@pytest.mark.slow
def test_intervals_of_groups_are_those_of_single_photographs(
    many: list[Path], expected: Swept
) -> None:
    alone = [scene_sums(load(path).grey_dn, PLAN).artefact(1, 1) for path in many]
    changes = local_changes(GaussianSignal(sigma_px=0.5), PLAN.scenario, "matched", 1.4)
    grouped, single = (
        d_primes(changes, artefact, 1.0, ("npw",))["npw"]
        for artefact in (expected.artefacts[1][1], ArtefactTiles.joined(alone))
    )
    assert grouped.value == pytest.approx(single.value, rel=1e-9)
    # Widths of 64 groups scatter by 9 %, of 300 photographs by 4 %; here four times that.
    width, expected_width = grouped.high - grouped.low, single.high - single.low
    assert width == pytest.approx(expected_width, rel=0.4)


def sums_in(folder: Path, paths: list[Path], plan: SweepPlan = PLAN) -> int:
    """Records of sums that a further run finds."""
    with Manifest(paths, folder) as manifest:
        records = Records(manifest, ArtefactWork(plan=plan, load=never, folder=folder))
        return len(list(records.merged()))


@pytest.mark.slow
def test_what_is_done_is_found_and_takes_one_record_a_group(
    many: list[Path], expected: Swept, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    swept(many, work_in(state))
    assert sums_in(state, many) <= 64
    [segment] = state.glob("*.records")
    before = segment.read_bytes()
    again = swept(many, work_in(state, never))
    assert again.found_done == 300
    assert again.bits == expected.bits
    assert [path.read_bytes() for path in state.glob("*.records")] == [before]


@pytest.mark.slow
def test_parts_in_any_order_give_the_same_bits(
    many: list[Path], expected: Swept, tmp_path: Path
) -> None:
    work = work_in(tmp_path / "state")
    with Manifest(many, work.folder) as manifest:
        for part in (2, 1):
            summary, _ = run_sweep(manifest, work, SweepOptions(part=(part, 3)))
            assert 0 < summary.images < 200
    last = swept(many, work)
    assert 0 < last.found_done < last.images
    assert last.bits == expected.bits


@pytest.mark.slow
def test_a_merge_that_was_killed_before_it_deleted_is_ended_by_the_next_run(
    many: list[Path], expected: Swept, tmp_path: Path
) -> None:
    work = work_in(tmp_path / "state")
    swept(many, work, tidy=False)
    before = {path: path.read_bytes() for path in work.folder.glob("*.records")}
    swept(many, work_in(work.folder, never))
    for path, data in before.items():
        path.write_bytes(data)
    found = swept(many, work_in(work.folder, never))
    assert found.found_done == 300
    assert found.bits == expected.bits
    assert not any(path.exists() for path in before)


@pytest.mark.slow
@pytest.mark.parametrize("before", [127, 128, 250, 298])
def test_only_what_is_new_is_measured_however_many_there_were(
    many: list[Path], expected: Swept, tmp_path: Path, before: int
) -> None:
    state = tmp_path / "state"
    swept(many[:before], work_in(state))
    opened: list[Path] = []

    def noted(path: Path) -> SceneImage:
        opened.append(path)
        return load(path)

    found = swept(many, work_in(state, noted))
    assert sorted(opened) == many[before:]
    assert (found.images, found.found_done) == (300, before)
    assert found.bits == expected.bits
    assert sums_in(state, many) <= 64
    again = swept(many, work_in(state, never))
    assert again.found_done == 300
    assert again.bits == expected.bits


@pytest.mark.slow
def test_a_damaged_record_is_measured_anew(
    many: list[Path], expected: Swept, tmp_path: Path
) -> None:
    work = work_in(tmp_path / "state")
    swept(many, work)
    [damaged] = work.folder.glob("*.records")
    data = bytearray(damaged.read_bytes())
    data[-30] ^= 1
    damaged.write_bytes(data)
    found = swept(many, work)
    assert 280 < found.found_done < 300
    assert found.bits == expected.bits


def test_corrupt_missing_and_small_photographs_are_refused_and_the_others_measured(
    tmp_path: Path,
) -> None:
    paths = scenes(tmp_path / "photographs", 6)
    paths[1].write_bytes(b"no array")
    paths[2].unlink()
    np.save(paths[3], np.ones((12, 12)))
    work = work_in(tmp_path / "state")
    found = swept(paths, work)
    assert (found.images, len(found.refused_lines)) == (3, 3)
    assert all(
        any(line.startswith(f"{path}: ") or str(path) in line for line in found.refused_lines)
        for path in paths[1:4]
    )
    assert [one.path for one in found.photographs] == [str(paths[k]) for k in (0, 4, 5)]
    assert len(found.artefacts[0][0].pixels) == 3
    with pytest.raises(AnalysisError):
        swept(paths[1:4], work)


def test_another_plan_is_measured_anew_and_what_is_no_longer_used_deleted(
    few: list[Path], tmp_path: Path
) -> None:
    work = work_in(tmp_path / "state")
    swept(few, work)
    plan = replace(PLAN, models=("bicubic",), zooms=(1.4,))
    with Manifest(few, work.folder) as manifest:
        summary, _ = run_sweep(manifest, replace(work, plan=plan))
        assert summary.found_done == 0
    assert (sums_in(work.folder, few), sums_in(work.folder, few, plan)) == (5, 5)
    with Manifest(few, work.folder) as manifest:
        Records(manifest, replace(work, plan=plan)).tidy()
    assert (sums_in(work.folder, few), sums_in(work.folder, few, plan)) == (0, 5)


def test_few_images_are_cut_into_tiles() -> None:
    assert [tiles_per_side(count) for count in (1, 2, 4, 15, 16, 5000)] == [4, 3, 2, 2, 1, 1]


def test_stored_sums_give_back_each_model_as_it_was(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    sums = ArtefactSums(
        products_dn2=rng.normal(size=(3, 2, 4, 5, 9)), pixels=rng.uniform(size=(3, 2, 4))
    )
    whole = SummedPhotographs()
    whole.add(sums)
    path, data = tmp_path / "one.records", whole.stored_bytes()
    path.write_bytes(b"before" + data + b"after")
    stored = StoredSums.of(Stored(path=path, at=6, size=len(data)))
    for model in range(3):
        [products], pixels = stored.sums(model)
        np.testing.assert_array_equal(products[0], sums.products_dn2[model])
        np.testing.assert_array_equal(pixels[0], sums.pixels[model])


def test_a_state_that_cannot_be_written_is_told_by_name(few: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ResultsFileError) as refused:
        Manifest(few, tmp_path / "file" / "state")
    assert str(tmp_path / "file") in str(refused.value)


@pytest.mark.slow
def test_worker_processes_give_the_same_bits(
    many: list[Path], expected: Swept, tmp_path: Path
) -> None:
    found = swept(many, work_in(tmp_path / "state"), SweepOptions(workers=2))
    assert found.images == 300
    assert found.bits == expected.bits


ROOT = Path(__file__).parents[3]
KILLS = 6

CLIENT = """
import sys, time
from pathlib import Path
from analysis.detectability._sweep import ArtefactWork
from analysis.sweep import Manifest, SweepOptions, run_sweep
from tests.analysis.detectability.test_sweep import PLAN, load

def slow_load(path):
    time.sleep(0.003)
    return load(path)

if __name__ == "__main__":
    state, photographs, workers = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    work = ArtefactWork(plan=PLAN, load=slow_load, folder=state)
    with Manifest(photographs.iterdir(), state) as manifest:
        print("begins", flush=True)
        run_sweep(manifest, work, SweepOptions(workers=workers))
"""


def begun(script: Path, state: Path, photographs: Path, workers: int) -> subprocess.Popen[str]:
    """Start a sweep; return when it begins."""
    client = subprocess.Popen(
        [sys.executable, str(script), str(state), str(photographs), str(workers)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert client.stdout is not None
    assert client.stdout.readline() == "begins\n"
    return client


def committed_bytes(state: Path) -> int:
    """Size of what is committed."""
    return sum(path.stat().st_size for path in state.glob("*.records"))


@pytest.mark.slow
def test_clients_killed_at_random_moments_leave_what_ends_with_the_same_bits(
    many: list[Path], expected: Swept, tmp_path: Path
) -> None:
    """Three without workers, and three with two of them, which end with their client.

    One of each is killed soon after it begins, the others soon after a commit, whenever that is.
    """
    state, script = tmp_path / "state", tmp_path / "client.py"
    script.write_text(CLIENT)
    rng = random.Random(5)
    for kill in range(KILLS):
        before = committed_bytes(state)
        client = begun(script, state, many[0].parent, 1 + kill % 2)
        while kill % 5 and committed_bytes(state) == before and client.poll() is None:
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.1))
        client.send_signal(signal.SIGKILL)
        client.communicate()
    found = swept(many, work_in(state))
    assert found.found_done > 0
    assert found.bits == expected.bits
    again = swept(many, work_in(state, never))
    assert again.found_done == 300
