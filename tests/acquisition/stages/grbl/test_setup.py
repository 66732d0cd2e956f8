from typing import Any

import pytest

from acquisition.bench import StageConfig
from acquisition.errors import DeviceProtocolError, DeviceSettingsError
from acquisition.stages.grbl_setup import check_settings, height_axis

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
