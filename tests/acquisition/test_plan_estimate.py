import pytest
from hypothesis import given, strategies as st

from acquisition.plan import estimate_plan, plan_entries
from tests.acquisition.session_fixtures import bench_of, plan_of


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
