"""Plans and how long they take."""

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import PlanError
from acquisition.plan import (
    CapturePlan,
    PlanEntry,
    estimate_plan,
    load_plan,
    parse_plan,
    plan_entries,
)
from tests.acquisition.session_fixtures import bench_of, plan_of

PLAN = """
schema = "standoff.plan/1"
name = "lens A"
heights_mm = [120.0, 100, 110.5]

[[targets]]
kind = "edge"
target = "slanted edge"
orientations_deg = [5, 95.5]

[[targets]]
kind = "flat"
target = "Ulbricht sphere"
heights_mm = { start = 50, stop = 50.3, step = 0.1 }
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "plan.toml"
    path.write_text(text, encoding="utf-8")
    return path


def planned(**changes: object) -> CapturePlan:
    table = {
        "schema": "standoff.plan/1",
        "name": "p",
        "heights_mm": [1.0, 2.0],
        "targets": [{"kind": "edge", "target": "E"}],
        **changes,
    }
    return parse_plan(table, source="plan")


def test_entries_are_numbered_in_the_order_of_work_with_heights_ascending(
    tmp_path: Path,
) -> None:
    entries = plan_entries(load_plan(write(tmp_path, PLAN)))
    assert [entry.index for entry in entries] == list(range(10))
    assert [(e.kind, e.orientation_deg, e.height_mm) for e in entries] == [
        ("edge", 5.0, 100.0),
        ("edge", 5.0, 110.5),
        ("edge", 5.0, 120.0),
        ("edge", 95.5, 100.0),
        ("edge", 95.5, 110.5),
        ("edge", 95.5, 120.0),
        ("flat", 0.0, 50.0),
        ("flat", 0.0, 50.1),
        ("flat", 0.0, 50.2),
        ("flat", 0.0, 50.3),
    ]


def test_repeats_follow_each_other_at_one_height() -> None:
    entries = plan_entries(planned(repeats=2))
    assert [(e.height_mm, e.repeat) for e in entries] == [(1, 0), (1, 1), (2, 0), (2, 1)]


def test_what_a_plan_leaves_out_has_a_default() -> None:
    plan = planned()
    assert (plan.frames_per_capture, plan.keep_frames, plan.repeats) == (None, False, 1)


def test_a_plan_survives_json_and_back(tmp_path: Path) -> None:
    plan = load_plan(write(tmp_path, PLAN))
    assert parse_plan(plan.to_json(), source="copy") == plan


@given(st.integers(-1000, 1000), st.integers(1, 500), st.integers(1, 2000))
def test_a_range_of_heights_holds_both_ends_and_no_rounding_error(
    start: int, step: int, steps: int
) -> None:
    table = {
        "start": start / 100,
        "stop": (start + step * steps) / 100,
        "step": step / 100,
    }
    heights = planned(heights_mm=table).heights_mm
    assert heights == tuple((start + i * step) / 100 for i in range(steps + 1))


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"heights_mm": []}, "heights_mm"),
        ({"heights_mm": [1.0, 1.0004]}, "heights_mm"),
        ({"heights_mm": [1.0, float("nan")]}, "heights_mm.1"),
        ({"heights_mm": {"start": 1, "stop": 2}}, "heights_mm"),
        ({"heights_mm": {"start": 1, "stop": 2, "step": 0}}, "heights_mm"),
        ({"heights_mm": {"start": 2, "stop": 1, "step": 1}}, "heights_mm"),
        ({"heights_mm": {"start": 1, "stop": 2, "step": 0.3}}, "heights_mm"),
        ({"heights_mm": {"start": 0, "stop": 1e9, "step": 1e-9}}, "heights_mm"),
        ({"heights_mm": {"start": 0, "stop": float("inf"), "step": 1}}, "heights_mm"),
        ({"heights_mm": {"start": 0, "stop": "1", "step": 1}}, "heights_mm"),
        ({"frames_per_capture": 1}, "frames_per_capture"),
        ({"repeats": 0}, "repeats"),
        ({"name": " "}, "name"),
        ({"schema": "standoff.plan/2"}, "schema"),
        ({"hights_mm": [1.0]}, "hights_mm"),
        ({"targets": []}, "targets"),
        ({"targets": [{"kind": "edges", "target": "E"}]}, "targets.0.kind"),
        ({"targets": [{"kind": "edge", "target": "a\nb"}]}, "targets.0.target"),
        (
            {"targets": [{"kind": "edge", "target": "E", "orientations_deg": [0, 0.0]}]},
            "targets.0.orientations_deg",
        ),
        (
            {"targets": [{"kind": "edge", "target": "E", "orientations_deg": [360]}]},
            "targets.0.orientations_deg.0",
        ),
    ],
)
def test_a_plan_that_is_not_accepted_names_the_key(changes: dict[str, object], key: str) -> None:
    with pytest.raises(PlanError) as caught:
        planned(**changes)
    assert key in caught.value.keys
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"heights_mm": None}, "targets.0.heights_mm"),
        ({"targets": [{"kind": "edge", "target": "E"}] * 2}, "targets.1"),
    ],
)
def test_targets_that_do_not_fit_together_are_named(changes: dict[str, object], key: str) -> None:
    with pytest.raises(PlanError) as caught:
        planned(**changes)
    assert key in str(caught.value)


def test_a_plan_file_at_fault_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlanError) as absent:
        load_plan(tmp_path / "absent.toml")
    assert absent.value.path == tmp_path / "absent.toml"
    file = write(tmp_path, "name =")
    with pytest.raises(PlanError) as no_toml:
        load_plan(file)
    assert no_toml.value.path == file
    file = write(tmp_path, 'schema = "standoff.plan/1"\nname = "p"')
    with pytest.raises(PlanError) as short:
        load_plan(file)
    assert short.value.keys == ("targets",)
    assert str(file) in str(short.value)


@pytest.mark.parametrize(
    ("orientation_deg", "height_mm", "stem"),
    [
        (90.0, 123.4, "0007_edge-090_h0123.400mm"),
        (0.0, 0.0, "0007_edge-000_h0000.000mm"),
        (22.5, -12.3, "0007_edge-022.5_h-012.300mm"),
        (100.0, 12345.6789, "0007_edge-100_h12345.679mm"),
    ],
)
def test_a_file_name_carries_index_kind_orientation_and_height(
    orientation_deg: float, height_mm: float, stem: str
) -> None:
    entry = PlanEntry(
        index=7, kind="edge", target="E", orientation_deg=orientation_deg, height_mm=height_mm
    )
    assert entry.stem == stem


@given(
    heights_mm=st.lists(st.integers(1, 300), min_size=1, max_size=6, unique=True),
    order=st.sampled_from(["ascending", "descending"]),
    repeats=st.integers(1, 3),
    is_checked=st.booleans(),
)
def test_each_orientation_is_one_sweep_from_one_side(
    heights_mm: list[int], order: str, repeats: int, is_checked: bool
) -> None:
    plan = planned(heights_mm=heights_mm, order=order, repeats=repeats, drift_check=is_checked)
    entries = plan_entries(plan)
    assert [entry.index for entry in entries] == list(range(len(entries)))
    sweep = sorted(map(float, heights_mm), reverse=order == "descending")
    expected = [height for height in sweep for _ in range(repeats)]
    expected += sweep[:1] * is_checked
    for placement in {entry.placement for entry in entries}:
        series = [entry for entry in entries if entry.placement == placement]
        assert [entry.height_mm for entry in series] == expected
        # Told apart by height and repeat, the drift check too.
        assert len({(entry.height_mm, entry.repeat) for entry in series}) == len(series)
    assert len({entry.stem for entry in entries}) == len(entries)


def test_a_kind_that_is_none_is_refused_with_those_that_are() -> None:
    with pytest.raises(ValueError):
        PlanEntry(
            index=0,
            kind="video",  # type: ignore[arg-type]  # wrong on purpose
            target="t",
            orientation_deg=0.0,
            height_mm=1.0,
        )


def test_time_and_room_of_a_small_plan_by_hand() -> None:
    plan = plan_of(
        keep_frames=True, heights_mm=[100.0, 110.0], targets=[{"kind": "edge", "target": "e"}]
    )
    estimate = estimate_plan(plan, plan_entries(plan), bench_of(), (4, 6))
    # From 150 mm down 50 mm and 2 x 0.5 mm of backlash, up 10 mm, at 5 mm/s; two ramps of 0.3 s
    # and settlings of 0.5 s; two captures of 4 frames at 50 Hz and 0.25 s.
    assert estimate.seconds == pytest.approx(61 / 5 + 2 * (0.3 + 0.5) + 2 * (4 * 0.02 + 0.25))
    assert (estimate.captures, estimate.placements) == (2, 1)
    assert estimate.bytes_ == 2 * 24 * (4 + 4 + 3 * 2)


@given(repeats=st.integers(1, 4), settle_s=st.floats(0, 10), is_checked=st.booleans())
def test_what_is_asked_for_more_takes_longer(
    repeats: int, settle_s: float, is_checked: bool
) -> None:
    plain = plan_of()
    more = plan_of(repeats=repeats, settle_s=settle_s, drift_check=is_checked)
    bench = bench_of()
    one, other = (estimate_plan(p, plan_entries(p), bench, None) for p in (plain, more))
    assert other.seconds >= one.seconds
    assert one.bytes_ is None
    assert other.placements == one.placements == 3
