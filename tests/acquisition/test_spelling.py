import pytest
from hypothesis import given, strategies as st

from acquisition.quantities import decimal_comma_remedy, nearest_key, toml_slip

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
