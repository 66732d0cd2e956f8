"""Settings of a GRBL controller, and the envelope of its moves."""

from typing import Any, Literal

import pytest
from hypothesis import given, strategies as st

from acquisition.bench import StageConfig
from acquisition.errors import DeviceProtocolError, DeviceSettingsError
from acquisition.stages._grbl_setup import (
    _WorkEnvelope,
    check_settings,
    expected_envelopes,
    height_axis,
    work_envelope,
)

SETTINGS = {13: "0", 20: "1", 22: "1", 23: "4", 24: "25.000", 27: "1.500"}
"""Homing towards minus on Z, whose bit of $23 is the third."""


def config(**keys: Any) -> StageConfig:
    return StageConfig.model_validate(
        {"driver": "grbl", "port": "virtual", "limits_mm": [0.0, 300.0], **keys}
    )


def test_the_settings_that_homing_depends_on_are_read() -> None:
    found = check_settings(SETTINGS, config(), name="grbl")
    assert found.is_homing_enabled
    assert not found.keeps_homed_on_reset
    assert found.towards_switch == -1.0
    assert (found.pull_off_mm, found.locate_feed_mm_per_min) == (1.5, 25.0)
    other_axis = check_settings(SETTINGS, config(axis="X"), name="grbl")
    assert other_axis.towards_switch == 1.0


def test_grblhals_settings_by_bits_are_read_and_what_it_does_not_list_is_grbls_default() -> None:
    # $22 = 128 + 1: homing, and homed still after a reset.
    found = check_settings({22: "129"}, config(), name="grblhal")
    assert found.is_homing_enabled
    assert found.keeps_homed_on_reset
    assert (found.pull_off_mm, found.locate_feed_mm_per_min) == (1.0, 25.0)
    assert not check_settings({22: "128"}, config(), name="grblhal").is_homing_enabled


def test_a_controller_that_reports_inches_is_refused_with_the_setting() -> None:
    with pytest.raises(DeviceSettingsError) as refused:
        check_settings(SETTINGS | {13: "1"}, config(), name="grbl")
    assert refused.value.settings == ("$13",)


def test_every_setting_that_is_not_as_expected_is_named_in_one_line() -> None:
    expected = {"$20": 0.0, "$27": 1.5, "$102": 250.0}
    with pytest.raises(DeviceSettingsError) as refused:
        check_settings(SETTINGS, config(expected_settings=expected), name="grbl")
    assert refused.value.settings == ("$20", "$102")
    assert "\n" not in str(refused.value)


def test_an_expected_setting_that_grbl_has_not_is_the_bench_files_fault() -> None:
    with pytest.raises(DeviceSettingsError) as refused:
        check_settings(SETTINGS, config(expected_settings={"resolution": 64.0}), name="grbl")
    assert refused.value.settings == ("resolution",)


@pytest.mark.parametrize("text", ["", "on", "1 (homing)", "nan", "inf", "1e999"])
def test_a_setting_that_is_no_number_is_named(text: str) -> None:
    with pytest.raises(DeviceProtocolError):
        check_settings(SETTINGS | {22: text}, config(), name="grbl")


def test_heights_and_machine_positions_belong_together_either_way() -> None:
    up = height_axis(config(home_offset_mm=20.0))
    assert (up.height_mm(30.0), up.machine_mm(50.0)) == (50.0, 30.0)
    down = height_axis(config(home_offset_mm=320.0, direction="down", axis="Y"))
    assert (down.height_mm(30.0), down.machine_mm(290.0)) == (290.0, 30.0)
    assert (down.letter, down.index) == ("Y", 1)


# By hand: 1.5 times the travel of each axis and two pull-offs of 1.5 mm at the seek rate, five
# pull-offs at 25 mm/min, four times 250 ms.
@pytest.mark.parametrize(
    ("homing", "expected_s"),
    [
        ("single_axis", 60 * (1.5 * 380 + 3) / 600 + 60 * 7.5 / 25 + 1),
        ("all_axes", 60 * (1.5 * (200 + 300 + 380) + 9) / 600 + 3 * 60 * 7.5 / 25 + 3),
    ],
)
def test_homing_may_take_the_controllers_travel_at_its_rates(
    homing: str, expected_s: float
) -> None:
    travels = {130: "200.000", 131: "300.000", 132: "-380.000"}
    settings = SETTINGS | travels | {25: "600.000", 26: "250"}
    found = check_settings(settings, config(homing=homing), name="grbl")
    assert found.homing_s == pytest.approx(expected_s)
    assert check_settings(SETTINGS, config(homing=homing), name="grbl").homing_s == 0.0


HOMING = {
    20: 1.0,
    21: 0.0,
    22: 1.0,
    23: 4.0,
    27: 1.5,
    130: 200.0,
    131: 200.0,
    132: 400.0,
}
"""Homing towards minus on Z, whose bit of $23 is the third."""

Family = Literal["Grbl", "grblHAL"]


def envelope(
    family: Family = "grblHAL", *, sets_origin: bool = False, keys: Any = None, **changed: float
) -> _WorkEnvelope:
    settings = HOMING | {int(name.removeprefix("s")): value for name, value in changed.items()}
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
    for settings in (HOMING | {132: 0.0}, {27: 1.0}):
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
