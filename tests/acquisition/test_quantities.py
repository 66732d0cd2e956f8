"""Quantities, units and spelling."""

import math
from contextlib import suppress

import pytest
from hypothesis import assume, given, strategies as st

from acquisition.quantities import (
    MISTAKEN_FOR,
    PLAUSIBLE,
    ImplausibleQuantityError,
    UnknownUnitError,
    _converted,
    _in_unit,
    _likely_slip,
    _PlausibleRange,
    _stated_number,
    _unit_of,
    decimal_comma_remedy,
    nearest_key,
    number_text,
    slip_between,
    toml_slip,
    understood,
)

SINGLE = sorted(name for name, plausible in PLAUSIBLE.items() if plausible.of == "each")
names = st.sampled_from(SINGLE)
magnitudes = st.floats(-15, 15).map(lambda power: 10.0**power)


def asked_about(name: str, value: object) -> ImplausibleQuantityError:
    with pytest.raises(ImplausibleQuantityError) as refused:
        understood(name, value)
    return refused.value


@pytest.mark.parametrize("name", sorted(PLAUSIBLE))
def test_each_key_has_a_unit_and_a_typical_value_in_its_range(name: str) -> None:
    plausible = PLAUSIBLE[name]
    assert _unit_of(name) is not None
    assert plausible.low < plausible.typical < plausible.high


@given(names, st.data())
def test_a_number_inside_the_range_is_taken_as_it_is(name: str, data: st.DataObject) -> None:
    plausible = PLAUSIBLE[name]
    value = data.draw(st.floats(plausible.low, plausible.high))
    assert understood(name, value) == value


@pytest.mark.slow
@given(names, magnitudes)
def test_a_number_outside_is_refused_with_what_was_meant_if_a_factor_brings_it_inside(
    name: str, value: float
) -> None:
    plausible, unit = PLAUSIBLE[name], str(_unit_of(name))
    assume(not plausible.low <= value <= plausible.high)
    question = asked_about(name, value)
    assert question.given == value
    # No more than rounding to 12 digits from the border is nobody's slip.
    low, high = plausible.low * (1 + 1e-9), plausible.high * (1 - 1e-9)
    factors = [_converted(1.0, other, unit) for other in MISTAKEN_FOR.get(unit, {})]
    if any(low <= value * factor <= high for factor in factors):
        assert isinstance(question.meant, float)
        assert plausible.low <= question.meant <= plausible.high
        written = number_text(question.meant)
        assert f"write {written}" in str(question)
        assert understood(name, float(written)) == float(written)


@given(st.sampled_from([name for name in SINGLE if str(_unit_of(name)) in ("us", "mm", "um")]))
def test_factors_of_a_thousand_are_among_the_slips_of_times_and_lengths(name: str) -> None:
    plausible, unit = PLAUSIBLE[name], str(_unit_of(name))
    value = plausible.typical / 1000
    if not plausible.holds(value):
        slip = _likely_slip(value, unit, plausible)
        assert slip is not None
        assert plausible.holds(slip.meant)


@pytest.mark.slow
@given(names, magnitudes)
def test_a_number_that_states_its_unit_is_never_asked_about(name: str, value: float) -> None:
    assert understood(name, f"{value!r} {_unit_of(name)}") == pytest.approx(value, rel=1e-11)


@given(st.text(max_size=20) | st.floats() | st.integers() | st.none() | st.booleans())
def test_any_value_is_returned_or_refused_with_a_value_error(value: object) -> None:
    for name in ("exposure_us", "limits_mm", "heights_mm"):
        for one in (value, [value, value, 3], {"start": value}):
            with suppress(ValueError):
                understood(name, one)


@pytest.mark.parametrize(
    ("name", "value", "meant", "what"),
    [
        ("exposure_us", 9, 9000, "milliseconds"),
        ("exposure_us", 0.009, 9000, "seconds"),
        ("exposure_us", 9e9, 9e6, "nanoseconds"),
        ("focal_length_mm", 0.008, 8, "metres"),
        ("focal_length_mm", 0.8, 8, "centimetres"),
        ("focal_length_mm", 8000, 8, "micrometres"),
        ("pixel_pitch_um", 0.0083, 8.3, "millimetres"),
        ("pixel_pitch_um", 8.3e-6, 8.3, "metres"),
        ("pixel_pitch_um", 8300, 8.3, "nanometres"),
        ("frame_rate_hz", 1 / 67.5, 67.5, "the period in seconds"),
        ("frame_rate_hz", 0.0675, 67.5, "kilohertz"),
        ("settle_s", 500, 0.5, "milliseconds"),
        ("tolerance_mm", 10, 0.01, "micrometres"),
        ("home_offset_mm", -519_500, -519.5, "micrometres"),
        ("bandwidth_limit_bytes_per_s", 115, 115e6, "megabytes per second"),
        ("bandwidth_limit_bytes_per_s", 1000, 125e6, "megabits per second"),
        ("feed_mm_per_min", 5, 300, "millimetres per second"),
    ],
)
def test_the_slip_of_the_bench_operator_is_named(
    name: str, value: float, meant: float, what: str
) -> None:
    question = asked_about(name, value)
    assert question.meant == pytest.approx(meant)
    slip = _likely_slip(value, str(_unit_of(name)), PLAUSIBLE[name])
    assert slip is not None
    assert slip.what.startswith(what)


def test_the_question_is_one_sentence_with_both_answers() -> None:
    assert str(asked_about("exposure_us", 9)) == (
        "= 9 is 9 microseconds; milliseconds were probably meant: write 9000, or "
        '"9 us" if it is right'
    )


def test_a_number_that_no_slip_explains_is_asked_about_with_the_range() -> None:
    question = asked_about("gain_db", 256)
    assert question.meant is None
    assert "between 0 and 60" in str(question)
    assert '"256 dB"' in str(question)


def test_one_number_of_a_list_is_asked_about_unless_it_states_its_unit() -> None:
    assert asked_about("exposure_us", [9, 3000.0]).given == 9
    assert understood("exposure_us", ["9 us", 3000.0, "3 ms"]) == [9, 3000.0, 3000]


@pytest.mark.parametrize(
    ("name", "value", "meant"),
    [
        ("limits_mm", [0.12, 0.62], [120, 620]),
        ("limits_mm", [120_000, 620_000], [120, 620]),
        ("heights_mm", [0, 0.18, 0.4], [0, 180, 400]),
        (
            "heights_mm",
            {"start": 0.1, "stop": 0.4, "step": 0.05},
            {"start": 100, "stop": 400, "step": 50},
        ),
    ],
)
def test_heights_are_judged_together(name: str, value: object, meant: object) -> None:
    assert asked_about(name, value).meant == meant
    confirmed = understood("limits_mm", ["0.12 mm", "0.62 mm"])
    assert confirmed == [0.12, 0.62]


@pytest.mark.parametrize("heights_mm", [[0], [0.0, 0.0], [0.5, 120], [-300, 20], []])
def test_heights_with_one_in_the_range_or_all_zero_are_taken(heights_mm: list[float]) -> None:
    assert understood("heights_mm", heights_mm) == heights_mm


@pytest.mark.parametrize("value", [-9, math.nan, math.inf, 10**400, True, None, "9,5", "Mono12"])
def test_what_the_key_itself_refuses_is_not_asked_about(value: object) -> None:
    assert understood("exposure_us", value) is value


def test_a_key_without_a_unit_is_left_alone() -> None:
    assert understood("f_number", "4 mm") == "4 mm"


def test_a_height_outside_the_travel_by_a_factor_of_a_thousand_is_explained() -> None:
    assert "300 mm" in slip_between(0.3, "mm", 120.0, 620.0)
    assert "300 mm" in slip_between(300_000, "mm", 120.0, 620.0)
    # 50 may be centimetres, or just too low.
    for value in (0.0, 50.0, 700.0, math.nan):
        assert slip_between(value, "mm", 120.0, 620.0) == ""


@given(magnitudes)
def test_of_several_slips_the_one_nearest_to_the_typical_value_is_named(value: float) -> None:
    wide = _PlausibleRange(1e-12, 1e12, 10.0)
    slip = _likely_slip(value, "mm", wide)
    if slip is not None:
        for other in MISTAKEN_FOR["mm"]:
            meant = _converted(value, other, "mm")
            if wide.low <= meant <= wide.high:
                assert abs(math.log10(slip.meant / 10)) <= abs(math.log10(meant / 10)) + 1e-9


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("exposure_us", "us"),
        ("limits_mm", "mm"),
        ("settle_s", "s"),
        ("feed_mm_per_min", "mm/min"),
        ("bandwidth_limit_bytes_per_s", "bytes/s"),
        ("frame_rate_hz", "Hz"),
        ("white_e_per_us", None),
        ("expected_settings", None),
        ("k1", None),
    ],
)
def test_the_unit_of_a_key_is_what_it_ends_in(name: str, unit: str | None) -> None:
    assert _unit_of(name) == unit


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("9 us", "us", 9),
        ("9us", "us", 9),
        ("9 µs", "us", 9),
        (" 9.5 ms ", "us", 9500),
        ("1e-2 s", "us", 10_000),
        ("8 MM", "mm", 8),
        ("0.3 m", "mm", 300),
        ("0.0083 mm", "um", 8.3),
        ("60 fps", "Hz", 60),
        ("2 min", "s", 120),
        ("1 Gbit/s", "bytes/s", 125_000_000),
        ("5 mm/s", "mm/min", 300),
        ("-12 cm", "mm", -120),
        ("9000", "us", 9000),
    ],
)
def test_text_is_converted_to_the_unit_of_the_key(text: str, unit: str, value: float) -> None:
    assert _in_unit(text, unit) == value


@pytest.mark.parametrize("text", ["", "us", "nine us", "9,0", "9,0 us", "1 2 us", "nan", "[9]"])
def test_text_that_holds_no_number_is_left_alone(text: str) -> None:
    assert _in_unit(text, "us") is None


def test_a_number_of_thousands_of_digits_is_read_without_delay() -> None:
    stated = _stated_number("9" * 50_000 + ",")
    assert stated is None


def test_a_unit_of_another_kind_is_refused_with_those_that_fit() -> None:
    with pytest.raises(UnknownUnitError) as refused:
        _in_unit("9 mm", "us")
    assert refused.value.unit == "mm"
    assert {"us", "ms", "s"} <= set(refused.value.known)


KEYS = [
    *("camera", "camera.driver", "camera.exposure_us", "camera.gain_db"),
    *(
        "stage",
        "stage.driver",
        "stage.limits_mm",
        "targets",
        "targets.target",
        "targets.heights_mm",
    ),
]


@pytest.mark.parametrize(
    ("text", "name", "remedy"),
    [
        ("9000,0", "", "write 9000.0 with a decimal point"),
        ("-0,01", "k1", "write -0.01 with a decimal point"),
        ("9,5 ms", "exposure_us", 'write "9.5 ms" with a decimal point'),
        ("9,000", "exposure_us", "write 9000"),
        ("0,008", "focal_length_mm", "write 0.008 with a decimal point"),
        ("1,500", "f_number", "write 1.500 or 1500 with a decimal point"),
    ],
)
def test_a_decimal_comma_is_answered_with_what_to_write(text: str, name: str, remedy: str) -> None:
    assert decimal_comma_remedy(text, name) == remedy


@pytest.mark.parametrize("text", ["9000.0", "1,2,3", "a,b", "1,", ",5", "", "1,5 2,5"])
def test_other_text_is_no_decimal_comma(text: str) -> None:
    assert decimal_comma_remedy(text) is None


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("exposure_us = 9000,0", "exposure_us = 9000,0: write 9000.0 with a decimal point"),
        ("f_number = 5,6  # wide", "f_number = 5,6: write 5.6 with a decimal point"),
        ("exposure_us = 9 ms", 'exposure_us = 9 ms: write "9 ms" in quotes'),
        ("stage.settle_s=0,5", "stage.settle_s = 0,5: write 0.5 with a decimal point"),
    ],
)
def test_the_line_of_a_toml_file_with_a_slip_is_named(line: str, said: str) -> None:
    assert toml_slip(f"[camera]\nx = 1\n{line}\ny = 2\n") == f"line 3: {said}"


@pytest.mark.parametrize(
    "line", ["exposure_us = 9000.0", "limits_mm = [1,5]", "a = 9 bananas", 'b = "1,5"', "# c = 1,5"]
)
def test_a_line_without_a_slip_is_not_named(line: str) -> None:
    assert toml_slip(line) is None


@pytest.mark.parametrize(
    ("key", "nearest"),
    [
        ("camera.exposure", "camera.exposure_us"),
        ("camera.drivr", "camera.driver"),
        ("stage.drivr", "stage.driver"),
        ("stage.gain_db", "camera.gain_db"),
        ("exposure_us", "camera.exposure_us"),
        ("target", "targets"),
        ("targets.height_mm", "targets.heights_mm"),
        ("camra", "camera"),
        ("camera.zzz", None),
    ],
)
def test_the_nearest_key_is_of_the_same_section_if_one_there_resembles_it(
    key: str, nearest: str | None
) -> None:
    assert nearest_key(key, KEYS) == nearest


@given(st.text())
def test_any_text_is_answered_or_not_but_never_an_error(text: str) -> None:
    decimal_comma_remedy(text)
    toml_slip(text)
    assert nearest_key(text, KEYS) in (None, *KEYS)
