"""The formulas of descriptions."""

import operator

import pytest
from hypothesis import assume, given, strategies as st

from acquisition.aravis._description import require_sound_description
from acquisition.aravis._formulas import (
    Extent,
    OverflowingDivisionError,
    extent_of_number,
    formula_extent,
)
from acquisition.errors import CameraDescriptionError
from tests.acquisition.aravis.description_texts import description, node

SMALL, SIGNED = Extent(bits=32), Extent(bits=32, is_signed=True)
WIDE = Extent(bits=64, is_signed=True)
VARIABLES = {"U": SMALL, "S": SIGNED, "W": WIDE}

SAFE = [
    "U / S",
    "W / 1000",
    "(W + 3) % 7",
    "W / U",
    "(U * 1000) / S",
    "((S + 1) << 8) / S",
    "(W & 0xff) / S",
    "(U > S) ? (U / S) : W",
    "2 + 3 * 4 - 5 / 1",
    "abs(S) / S",
    "W",
    "U / ",
    ") U / S (",
    "W $ S",
    "",
]
UNSAFE = [
    "9223372036854775807/(0-1)",  # Aravis reads it by way of a double, as -2^63
    "(1 << 63) / (0 - 1)",
    "(1<<63)%-1",
    "W / S",
    "W % S",
    "W / W",
    "(U * W) / S",
    "(S * S) / S",
    "(U ** 2) / S",
    "(U << U) / S",
    "-W / -1",
    "1 ? W / S : 0",
    "(S ? W : U) / (U - 1)",
    "W / (U - 2)",
    "1e300 / S",
]


@pytest.mark.parametrize("formula", SAFE)
def test_formulas_that_cannot_divide_the_smallest_number_by_minus_one_pass(formula: str) -> None:
    formula_extent(formula, VARIABLES, is_integer=True)


@pytest.mark.parametrize("formula", UNSAFE)
def test_formulas_that_may_do_so_are_refused(formula: str) -> None:
    with pytest.raises(OverflowingDivisionError):
        formula_extent(formula, VARIABLES, is_integer=True)


def test_fractions_have_no_such_quotient_but_remainders_are_always_whole() -> None:
    formula_extent("W / S", VARIABLES, is_integer=False)
    with pytest.raises(OverflowingDivisionError):
        formula_extent("W % S", VARIABLES, is_integer=False)


NUMBERS = st.integers(-(2**20), 2**20)
EXPRESSIONS = st.recursive(
    st.tuples(st.sampled_from("ab")) | st.tuples(st.just("n"), st.integers(0, 2**20)),
    lambda inner: (
        st.tuples(st.sampled_from(["+", "-", "*", "&", "|", "^"]), inner, inner)
        | st.tuples(st.just("neg"), inner)
    ),
    max_leaves=6,
)
OPERATORS = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "&": operator.and_,
    "|": operator.or_,
    "^": operator.xor,
}


def written(tree: tuple[object, ...]) -> str:
    match tree:
        case (("a" | "b") as name,):
            return str(name)
        case ("n", number):
            return str(number)
        case ("neg", tuple(inner)):
            return f"-({written(inner)})"
        case (sign, tuple(left), tuple(right)):
            return f"({written(left)} {sign} {written(right)})"
    raise AssertionError(tree)


def value(tree: tuple[object, ...], a: int, b: int) -> int:
    match tree:
        case ("a",):
            return a
        case ("b",):
            return b
        case ("n", int(number)):
            return number
        case ("neg", tuple(inner)):
            return -value(inner, a, b)
        case (str(sign), tuple(left), tuple(right)):
            return int(OPERATORS[sign](value(left, a, b), value(right, a, b)))
    raise AssertionError(tree)


@pytest.mark.slow
@given(EXPRESSIONS, NUMBERS, st.integers(0, 2**20))
def test_no_value_is_larger_than_its_extent_or_negative_against_it(
    tree: tuple[object, ...], a: int, b: int
) -> None:
    known = {"a": Extent(bits=20, is_signed=True), "b": Extent(bits=20)}
    extent = formula_extent(written(tree), known, is_integer=True)
    exact = value(tree, a, b)
    assume(abs(exact) < 2**62)
    assert abs(exact) <= 2**extent.bits
    assert exact >= 0 or extent.is_signed


@pytest.mark.parametrize(
    ("text", "literal"), [("4", 4), ("0x10", 16), ("-5", -5), ("2.0", 2), ("x", None), ("", None)]
)
def test_written_numbers_are_read_as_aravis_reads_them(text: str, literal: int | None) -> None:
    assert extent_of_number(text).literal == literal


@pytest.mark.parametrize(
    "nodes",
    [
        [node("IntSwissKnife", "A", "<Formula>(1&lt;&lt;63)/(0-1)</Formula>")],
        [
            node("Integer", "N", "<Value>-1</Value>"),
            '<IntReg Name="L"><Address>0</Address><Length>8</Length><pPort>Device</pPort></IntReg>',
            node(
                "IntSwissKnife",
                "A",
                '<pVariable Name="L">L</pVariable><pVariable Name="N">N</pVariable>'
                "<Formula>L / N</Formula>",
            ),
        ],
        [
            node(
                "IntSwissKnife",
                "A",
                '<Constant Name="C">-1</Constant><Expression Name="X">1 &lt;&lt; 63</Expression>'
                "<Formula>X / C</Formula>",
            )
        ],
        [
            '<FloatReg Name="F"><Address>0</Address><Length>8</Length><pPort>Device</pPort>'
            "</FloatReg>",
            node(
                "IntConverter",
                "A",
                "<FormulaTo>FROM</FormulaTo><FormulaFrom>TO % -1</FormulaFrom><pValue>F</pValue>",
            ),
        ],
        [node("SwissKnife", "A", f"<Formula>{'1+' * 40_000}1</Formula>")],
    ],
)
def test_the_formula_of_a_node_is_refused_by_its_name(nodes: list[str]) -> None:
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(description(*nodes), "the camera")
    assert (refused.value.fault, refused.value.nodes) == ("formula", ("A",))


def test_a_register_of_four_bytes_may_be_divided_by_any_other() -> None:
    formula = '<pVariable Name="V">R</pVariable><pVariable Name="D">D</pVariable>'
    require_sound_description(
        description(
            node("Integer", "D", "<Value>-1</Value>"),
            node("IntSwissKnife", "A", f"{formula}<Formula>V / D</Formula>"),
        ),
        "the camera",
    )
