import math
from contextlib import suppress

import pytest
import typer
from hypothesis import given, strategies as st

from acquisition.quantities import decimals_meant
from standoff.terminal import ListedNumbers, number_list

ZOOMS = ListedNumbers(option="--zooms", least=1.0, pair_most=10.0)
NOISES = ListedNumbers(option="--noise")


@pytest.mark.parametrize(
    ("text", "listed", "meant"),
    [
        ("1,25", ZOOMS, "1.25"),
        ("1,05", ZOOMS, "1.05"),
        ("1,0,1,5", ZOOMS, "1.0,1.5"),
        ("1,5,2,5", ZOOMS, "1.5,2.5"),
        ("1,5;2,5", ZOOMS, "1.5,2.5"),
        ("1,5 2 2,5", ZOOMS, "1.5,2,2.5"),
        ("0,5", NOISES, "0.5"),
        ("0,5,1,5", NOISES, "0.5,1.5"),
    ],
)
def test_a_list_that_makes_sense_with_decimal_commas_only_is_refused_with_points(
    text: str, listed: ListedNumbers, meant: str
) -> None:
    assert decimals_meant(text, listed.accepts, listed.pair_most) == meant
    with pytest.raises(typer.BadParameter) as refused:
        number_list(text, listed)
    assert f"write {meant}" in str(refused.value)


@pytest.mark.parametrize(
    ("text", "listed", "values"),
    [
        ("1,1.01,1.5,2", ZOOMS, [1, 1.01, 1.5, 2]),
        ("1.5,1", ZOOMS, [1.5, 1]),
        ("1,2,4,8,16", ZOOMS, [1, 2, 4, 8, 16]),
        ("1.0,25", ZOOMS, [1, 25]),
        ("1,2,3,4", ZOOMS, [1, 2, 3, 4]),
        ("1,2,4", NOISES, [1, 2, 4]),
        ("6,12", NOISES, [6, 12]),
        ("4,4", NOISES, [4]),
        ("12", NOISES, [12]),
    ],
)
def test_a_list_that_makes_sense_is_taken_as_it_is(
    text: str, listed: ListedNumbers, values: list[float]
) -> None:
    assert number_list(text, listed) == values


def test_two_zooms_that_may_be_one_are_read_with_a_note(capsys: pytest.CaptureFixture[str]) -> None:
    assert number_list("1,5", ZOOMS) == [1.0, 5.0]
    assert "1.5" in capsys.readouterr().err
    number_list("1,5", NOISES)
    number_list("1.0,5", ZOOMS)
    assert capsys.readouterr().err == ""


@given(st.lists(st.floats(1, 100), min_size=1, max_size=6, unique=True))
def test_a_list_with_decimal_points_is_never_asked_about(values: list[float]) -> None:
    text = ",".join(f"{value:.4f}" for value in values)
    expected = list(dict.fromkeys(float(part) for part in text.split(",")))
    assert number_list(text, ZOOMS) == expected


@given(st.text("0123456789,.;- e", max_size=20))
def test_any_text_is_a_list_or_wrong_usage(text: str) -> None:
    with suppress(typer.BadParameter):
        assert all(NOISES.accepts(value) for value in number_list(text, NOISES))


def test_numbers_of_either_sign_are_read_and_infinite_ones_refused() -> None:
    any_sign = ListedNumbers(option="--contrast", least=-math.inf)
    assert number_list("-150,12", any_sign) == [-150.0, 12.0]
    with pytest.raises(typer.BadParameter, match="numbers that are finite, got inf"):
        number_list("12,inf", any_sign)
