"""Every plausible number is taken, every other is asked about, with the slip that explains it."""

import math
from contextlib import suppress

import pytest
from hypothesis import assume, given, strategies as st

from acquisition.quantities import (
    MISTAKEN_FOR,
    PLAUSIBLE,
    ImplausibleQuantityError,
    PlausibleRange,
    converted,
    likely_slip,
    number_text,
    slip_between,
    understood,
    unit_of,
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
    assert unit_of(name) is not None
    assert plausible.low < plausible.typical < plausible.high


@given(names, st.data())
def test_a_number_inside_the_range_is_taken_as_it_is(name: str, data: st.DataObject) -> None:
    plausible = PLAUSIBLE[name]
    value = data.draw(st.floats(plausible.low, plausible.high))
    assert understood(name, value) == value


@given(names, magnitudes)
def test_a_number_outside_is_refused_with_what_was_meant_if_a_factor_brings_it_inside(
    name: str, value: float
) -> None:
    plausible, unit = PLAUSIBLE[name], str(unit_of(name))
    assume(not plausible.low <= value <= plausible.high)
    question = asked_about(name, value)
    assert question.given == value
    # No more than rounding to 12 digits from the border is nobody's slip.
    low, high = plausible.low * (1 + 1e-9), plausible.high * (1 - 1e-9)
    factors = [converted(1.0, other, unit) for other in MISTAKEN_FOR.get(unit, {})]
    if any(low <= value * factor <= high for factor in factors):
        assert isinstance(question.meant, float)
        assert plausible.low <= question.meant <= plausible.high
        written = number_text(question.meant)
        assert f"write {written}" in str(question)
        assert understood(name, float(written)) == float(written)


@given(st.sampled_from([name for name in SINGLE if str(unit_of(name)) in ("us", "mm", "um")]))
def test_factors_of_a_thousand_are_among_the_slips_of_times_and_lengths(name: str) -> None:
    plausible, unit = PLAUSIBLE[name], str(unit_of(name))
    value = plausible.typical / 1000
    if not plausible.holds(value):
        slip = likely_slip(value, unit, plausible)
        assert slip is not None
        assert plausible.holds(slip.meant)


@given(names, magnitudes)
def test_a_number_that_states_its_unit_is_never_asked_about(name: str, value: float) -> None:
    assert understood(name, f"{value!r} {unit_of(name)}") == pytest.approx(value, rel=1e-11)


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
    slip = likely_slip(value, str(unit_of(name)), PLAUSIBLE[name])
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
    wide = PlausibleRange(1e-12, 1e12, 10.0)
    slip = likely_slip(value, "mm", wide)
    if slip is not None:
        for other in MISTAKEN_FOR["mm"]:
            meant = converted(value, other, "mm")
            if wide.low <= meant <= wide.high:
                assert abs(math.log10(slip.meant / 10)) <= abs(math.log10(meant / 10)) + 1e-9
