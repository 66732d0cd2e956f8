"""The work envelope, from the formulas of the two firmwares' sources."""

from typing import Any, Literal

import pytest
from hypothesis import given, strategies as st

from acquisition.bench import StageConfig
from acquisition.stages.grbl_setup import WorkEnvelope, expected_envelopes, work_envelope

SETTINGS = {20: 1.0, 21: 0.0, 22: 1.0, 23: 4.0, 27: 1.5, 130: 200.0, 131: 200.0, 132: 400.0}
"""Homing towards minus on Z, whose bit of $23 is the third."""

Family = Literal["Grbl", "grblHAL"]


def config(**keys: Any) -> StageConfig:
    return StageConfig.model_validate(
        {"driver": "grbl", "port": "virtual", "limits_mm": [0.0, 300.0], **keys}
    )


def envelope(
    family: Family = "grblHAL", *, sets_origin: bool = False, keys: Any = None, **changed: float
) -> WorkEnvelope:
    settings = SETTINGS | {int(name.removeprefix("s")): value for name, value in changed.items()}
    found = work_envelope(settings, config(**(keys or {})), family=family, sets_origin=sets_origin)
    assert found is not None
    return found


# Machine positions by hand, as home_offset_mm is 0: the travel is 400 mm, the pull-off 1.5 mm.
@pytest.mark.parametrize(
    ("family", "hard", "inverted", "sets_origin", "low_mm", "high_mm"),
    [
        ("Grbl", 0, 4, False, -400.0, 0.0),
        ("Grbl", 0, 0, False, -400.0, 0.0),
        ("Grbl", 1, 4, False, -398.5, 0.0),
        ("Grbl", 1, 0, False, -400.0, -1.5),
        ("Grbl", 1, 4, True, 0.0, 400.0),
        ("Grbl", 1, 0, True, -400.0, 0.0),
        ("grblHAL", 0, 4, False, -400.0, 0.0),
        ("grblHAL", 1, 4, False, -398.5, -1.5),
        ("grblHAL", 3, 0, False, -398.5, -1.5),
        ("grblHAL", 0, 4, True, 0.0, 400.0),
        ("grblHAL", 1, 4, True, 0.0, 398.5),
        ("grblHAL", 1, 0, True, -398.5, 0.0),
    ],
)
def test_the_pull_off_is_taken_off_where_the_firmware_takes_it_off(
    family: Family, hard: int, inverted: int, sets_origin: bool, low_mm: float, high_mm: float
) -> None:
    found = envelope(family, sets_origin=sets_origin, s21=hard, s23=inverted)
    assert (found.low_mm, found.high_mm) == (low_mm, high_mm)
    assert (found.travel_setting, found.travel_mm) == ("$132", 400.0)
    kept_off_mm = found.travel_mm - (high_mm - low_mm)
    assert kept_off_mm == pytest.approx(1.5 * len(found.shortened_at), abs=1e-9)


def test_heights_are_those_of_the_bench_file_whichever_way_the_axis_counts() -> None:
    up = envelope(s21=1.0, keys={"home_offset_mm": 519.5})
    assert (up.low_mm, up.high_mm) == (121.0, 518.0)
    down = envelope(s21=1.0, keys={"home_offset_mm": 20.0, "direction": "down", "axis": "X"})
    assert (down.low_mm, down.high_mm) == (21.5, 218.5)
    assert down.travel_setting == "$130"


def test_a_controller_that_states_no_travel_has_no_envelope() -> None:
    for settings in (SETTINGS | {132: 0.0}, {27: 1.0}):
        assert work_envelope(settings, config(), family="Grbl", sets_origin=False) is None


def test_limits_within_the_envelope_have_no_fault_and_limits_beyond_say_both_in_numbers() -> None:
    found = envelope(s21=1.0, keys={"home_offset_mm": 519.5})
    assert found.fault((121.0, 518.0)) is None
    fault = found.fault((120.0, 500.0))
    assert fault is not None
    for number in ("120 to 500", "121 to 518", "$132 = 400", "$27 = 1.5"):
        assert number in fault.found
    assert "limits_mm = [121, 500]" in fault.remedy
    assert "shorter $27" in fault.remedy


def test_a_shorter_pull_off_is_no_remedy_where_none_is_taken_off() -> None:
    fault = envelope(keys={"home_offset_mm": 519.5}).fault((119.0, 500.0))
    assert fault is not None
    assert "$27 =" in fault.found
    assert "shorter $27" not in fault.remedy


def test_limits_of_which_nothing_is_reached_point_to_the_home_offset() -> None:
    fault = envelope().fault((10.0, 300.0))
    assert fault is not None
    assert "home_offset_mm" in fault.remedy
    assert "limits_mm" not in fault.remedy


@given(
    family=st.sampled_from(["Grbl", "grblHAL"]),
    hard=st.sampled_from([0.0, 1.0]),
    inverted=st.sampled_from([0.0, 4.0]),
    sets_origin=st.booleans(),
    travel_mm=st.integers(20, 2000),
    pull_off_mm=st.integers(1, 50).map(lambda tenths: tenths / 10),
    offset_mm=st.integers(-2000, 2000),
)
def test_an_envelope_is_within_the_travel_and_its_own_limits_have_no_fault(
    family: Family,
    hard: float,
    inverted: float,
    sets_origin: bool,
    travel_mm: int,
    pull_off_mm: float,
    offset_mm: int,
) -> None:
    settings = {21: hard, 23: inverted, 27: pull_off_mm, 132: float(travel_mm)}
    found = work_envelope(
        settings, config(home_offset_mm=offset_mm), family=family, sets_origin=sets_origin
    )
    assert found is not None
    assert found.fault((found.low_mm, found.high_mm)) is None
    assert found.fault((found.low_mm - 0.01, found.high_mm)) is not None
    assert found.fault((found.low_mm, found.high_mm + 0.01)) is not None
    assert travel_mm - 2 * pull_off_mm <= found.high_mm - found.low_mm + 1e-6 <= travel_mm + 2e-6


def expecting(**settings: float) -> Any:
    named = {f"${name.removeprefix('s')}": value for name, value in settings.items()}
    return expected_envelopes(config(home_offset_mm=519.5, expected_settings=named))


def test_a_bench_file_that_names_everything_leaves_only_the_firmware_open() -> None:
    found = expecting(s21=1.0, s23=4.0, s27=1.0, s132=400.0)
    assert found.unnamed == ()
    assert (found.largest.low_mm, found.largest.high_mm) == (120.5, 519.5)
    assert (found.smallest.low_mm, found.smallest.high_mm) == (120.5, 518.5)
    off = expecting(s21=0.0, s23=4.0, s27=1.0, s132=400.0)
    assert off.largest == off.smallest


def test_hard_limits_that_a_bench_file_does_not_name_may_be_on() -> None:
    found = expecting(s27=1.0, s132=400.0)
    assert found.unnamed == ("$21", "$23")
    assert (found.largest.low_mm, found.largest.high_mm) == (119.5, 519.5)
    assert (found.smallest.low_mm, found.smallest.high_mm) == (120.5, 518.5)


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param({"s27": 1.0}, id="no travel"),
        pytest.param({"s132": 400.0}, id="no pull-off"),
        pytest.param({"s22": 9.0, "s27": 1.0, "s132": 400.0}, id="an origin at either end"),
    ],
)
def test_a_bench_file_that_names_too_little_tells_nothing(settings: dict[str, float]) -> None:
    found = expecting(**settings)
    assert found.largest is found.smallest is None
    assert found.unnamed
