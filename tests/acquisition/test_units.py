import pytest

from acquisition.quantities import UnknownUnitError, in_unit, stated_number, unit_of


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
    assert unit_of(name) == unit


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
    assert in_unit(text, unit) == value


@pytest.mark.parametrize("text", ["", "us", "nine us", "9,0", "9,0 us", "1 2 us", "nan", "[9]"])
def test_text_that_holds_no_number_is_left_alone(text: str) -> None:
    assert in_unit(text, "us") is None


def test_a_number_of_thousands_of_digits_is_read_without_delay() -> None:
    stated = stated_number("9" * 50_000 + ",")
    assert stated is None


def test_a_unit_of_another_kind_is_refused_with_those_that_fit() -> None:
    with pytest.raises(UnknownUnitError) as refused:
        in_unit("9 mm", "us")
    assert refused.value.unit == "mm"
    assert {"us", "ms", "s"} <= set(refused.value.known)
