"""What the sets hold: numbers of tasks, regions within frames, twins of changed pairs."""

from collections import Counter

import numpy as np
import pytest

from hil_mocks.benchmark_set._camera_tracks import EdgeChart, Simulation
from hil_mocks.benchmark_set._depth import DEEP_KINDS
from hil_mocks.benchmark_set._documents import benchmark_tasks, document_bytes
from hil_mocks.benchmark_set._lenses import round_lens
from hil_mocks.benchmark_set._pair_tracks import Alignment, ChangedPair, behind_blur
from hil_mocks.benchmark_set._photographs import STEPS_PER_DN
from hil_mocks.benchmark_set._tasks import SIZES


@pytest.mark.parametrize("size", SIZES)
def test_a_set_has_the_tasks_that_its_size_says_under_names_of_their_own(size: str) -> None:
    tasks, known = benchmark_tasks(size, 1), SIZES[size]
    names = Counter((task.track, task.name) for task in tasks)
    assert set(names.values()) == {1}
    assert Counter(task.track for task in tasks) == {
        "psf": known.edge_charts + known.photographs,
        "simulation": known.simulations,
        "alignment": known.alignments,
        "changes": known.changes + known.deep_changes,
        "things": known.things + known.lone_things,
    }
    unrelated = [task for task in tasks if isinstance(task, Alignment) and task.other_scene]
    assert len(unrelated) == known.unrelated
    assert all(task.other_scene != task.scene_name for task in unrelated)


@pytest.mark.parametrize("size", SIZES)
def test_every_edge_is_within_its_frame_and_alone_in_its_region(size: str) -> None:
    for task in benchmark_tasks(size, 1):
        if not isinstance(task, EdgeChart):
            continue
        chart = task.chart
        rows, cols = chart.shape
        assert len(chart.edges()) == 24
        for (_, normal_deg, (x0, y0, x1, y1)), told in zip(
            chart.edges(), chart.task_edges(), strict=True
        ):
            assert 0 <= x0 < x1 <= cols
            assert 0 <= y0 < y1 <= rows
            slant = min(normal_deg % 90, 90 - normal_deg % 90)
            assert 2.9 < slant <= 40
            assert abs((told["angle_deg"] - normal_deg) % 180 - 90) <= 0.5


def test_half_of_the_pairs_have_a_change_and_a_twin_without() -> None:
    pairs = [task for task in benchmark_tasks("small", 1) if isinstance(task, ChangedPair)]
    by_pair: dict[str, list[ChangedPair]] = {}
    for task in pairs:
        by_pair.setdefault(task.pair, []).append(task)
    for twins in by_pair.values():
        assert sorted(task.is_changed for task in twins) == [False, True]
        first, second = twins
        assert (first.scene_name, first.kind, first.lens, first.condition) == (
            second.scene_name,
            second.kind,
            second.lens,
            second.condition,
        )


def test_every_kind_and_most_scenes_are_in_every_track_of_the_small_set() -> None:
    tasks = benchmark_tasks("small", 1)
    for track in ("simulation", "alignment", "changes"):
        seen = {task.scene_name for task in tasks if task.track == track}
        assert seen == set(SIZES["small"].scenes)
    kinds = Counter(task.kind for task in tasks if isinstance(task, ChangedPair))
    deep = {kind: kinds.pop(kind) for kind in DEEP_KINDS}
    assert min(kinds.values()) == max(kinds.values()) == 12
    assert set(deep.values()) == {16}


@pytest.mark.slow
def test_a_changed_pair_shows_its_spots_and_nothing_else() -> None:
    task = next(
        each
        for each in benchmark_tasks("tiny", 1)
        if isinstance(each, ChangedPair) and each.is_changed and each.kind == "frontal"
    )
    made = task.rendered()
    change = made.files[f"truth/changes/{task.name}.tif"]
    levels = np.frombuffer(change[-2 * 112 * 144 :], "<i2").reshape(112, 144) / STEPS_PER_DN
    spots = made.truth["spots"]
    assert len(spots) >= 4
    for spot in spots:
        there = levels[round(spot["y_px"]), round(spot["x_px"])]
        # The blur by a Gaussian of the same MTF50, and a place between pixels: within a quarter.
        expected = spot["amplitude_dn"] * behind_blur(task.lens, spot["sigma_px"])
        assert there == pytest.approx(expected, rel=0.25, abs=0.1)
    volume = sum(2 * np.pi * s["sigma_px"] ** 2 * s["amplitude_dn"] for s in spots)
    assert levels.sum() == pytest.approx(volume, rel=0.02)


def test_a_wide_spot_keeps_its_peak_behind_a_sharp_lens() -> None:
    assert behind_blur(round_lens(0.3), 30.0) == pytest.approx(1, abs=1e-3)


def test_a_followup_of_the_simulation_track_is_within_its_reference() -> None:
    for task in benchmark_tasks("small", 1):
        if not isinstance(task, Simulation):
            continue
        pose = task.view.pose
        rows, cols = pose.followup_shape
        x, y = np.meshgrid([0.0, cols - 1], [0.0, rows - 1])
        u, v = pose.reference_points(x, y)
        inside = (u >= 0) & (u <= 319) & (v >= 0) & (v <= 239)
        assert inside.sum() >= (4 if task.kind == "frontal" else 2), task


def test_numbers_of_documents_have_ten_digits_and_no_remains_of_rounding() -> None:
    found = document_bytes({"b": [1 / 3, 1e-17, 2], "a": True})
    assert "".join(found.decode().split()) == '{"a":true,"b":[0.3333333333,0.0,2]}'
