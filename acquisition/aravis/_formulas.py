"""How large the values of formulas can be: Aravis divides -2^63 by -1, which ends the process.

The quotient has no place in 64 bits, and the processor answers with an arithmetic exception
(SIGFPE; Aravis 0.8.26 to 0.8.35). Values are followed by the number of their bits and whether they
can be negative: what comes from a register of four bytes is never -2^63, and what is counted is
never -1. The syntax is that of Aravis' evaluator.

References
----------
GenICam Standard, GenApi 2.1.1, EMVA, 2018: formulas of the SwissKnife.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

_WIDE = 64
SAFE_BITS = 62
"""Most bits of which nothing, not even the next sum, is -2^63."""

LONGEST_FORMULA = 1 << 16
"""Letters; the longest of real cameras has 2 043."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """A value is at most 2^bits on either side of 0; ``literal`` is that of a written number."""

    bits: int
    is_signed: bool = False
    literal: int | None = None


ANYTHING = Extent(bits=_WIDE, is_signed=True)
NOTHING = Extent(bits=0)
TRUTH = Extent(bits=1)


class OverflowingDivisionError(ValueError):
    """A formula may divide -2^63 by -1."""


def extent_of_number(text: str) -> Extent:
    """Extent of a written number; of what is none it is that of 0, as Aravis takes it."""
    try:
        number = int(text, 0) if not text.startswith("0") or "x" in text.lower() else int(text)
    except ValueError:
        try:
            real = float(text)
        except ValueError:
            return NOTHING
        if not abs(real) < 2.0**SAFE_BITS:  # NaN as well
            return ANYTHING
        number = round(real)
    bits = abs(number).bit_length()
    if bits > SAFE_BITS:
        return ANYTHING
    return Extent(bits=bits, is_signed=number < 0, literal=number)


def either(one: Extent, other: Extent) -> Extent:
    """Extent of a value that is one of two."""
    return Extent(bits=max(one.bits, other.bits), is_signed=one.is_signed or other.is_signed)


def formula_extent(formula: str, variables: Mapping[str, Extent], *, is_integer: bool) -> Extent:
    """Return the extent of a formula's value; refused if it may divide -2^63 by -1."""
    stack: list[Extent] = []
    for symbol in _reverse_polish(formula):
        operation = _OPERATIONS.get(symbol)
        if operation is None:
            is_number = symbol[0].isdigit()
            stack.append(extent_of_number(symbol) if is_number else variables.get(symbol, ANYTHING))
            continue
        if len(stack) < operation.operands:
            return ANYTHING  # Aravis stops here
        operands = stack[len(stack) - operation.operands :]
        del stack[len(stack) - operation.operands :]
        if symbol == "%" or (symbol == "/" and is_integer):
            dividend, divisor = operands
            if dividend.bits > SAFE_BITS and divisor.is_signed:
                raise OverflowingDivisionError("may divide -2^63 by -1, which ends the program")
        if symbol == "/" and not is_integer:
            stack.append(Extent(bits=_WIDE, is_signed=any(o.is_signed for o in operands)))
        else:
            extent = operation.extent(*operands)
            stack.append(extent if extent.bits <= SAFE_BITS else ANYTHING)
    return stack[0] if len(stack) == 1 else ANYTHING


@dataclass(frozen=True, slots=True, kw_only=True)
class _Operation:
    precedence: int
    operands: int
    extent: Callable[..., Extent]
    is_from_right: bool = False


def _wide(bits: int, *operands: Extent) -> Extent:
    """Extent of so many bits, signed where one of the operands is."""
    return Extent(bits=bits, is_signed=any(operand.is_signed for operand in operands))


def _conjunction(a: Extent, b: Extent) -> Extent:
    counted = [extent.bits for extent in (a, b) if not extent.is_signed]
    return Extent(bits=min(counted)) if counted else either(a, b)


def _shifted_left(a: Extent, b: Extent) -> Extent:
    if b.literal is None or not 0 <= b.literal < _WIDE:
        return ANYTHING
    return _wide(a.bits + b.literal, a)


def _negated(a: Extent) -> Extent:
    literal = None if a.literal is None else -a.literal
    is_signed = literal is None or literal < 0
    return Extent(bits=a.bits, is_signed=is_signed, literal=literal)


def _truth(*_: Extent) -> Extent:
    return TRUTH


def _anything(*_: Extent) -> Extent:
    return ANYTHING


def _binary(precedence: int, extent: Callable[[Extent, Extent], Extent]) -> _Operation:
    return _Operation(precedence=precedence, operands=2, extent=extent)


def _unary(precedence: int, extent: Callable[[Extent], Extent]) -> _Operation:
    return _Operation(precedence=precedence, operands=1, extent=extent, is_from_right=True)


_OPERATIONS = {
    "?": _Operation(
        precedence=5, operands=3, extent=lambda _, b, c: either(b, c), is_from_right=True
    ),
    ":": _unary(5, lambda a: a),
    "||": _binary(10, _truth),
    "&&": _binary(20, _truth),
    "|": _binary(40, either),
    "^": _binary(50, either),
    "&": _binary(60, _conjunction),
    "=": _binary(70, _truth),
    "<>": _binary(70, _truth),
    "<=": _binary(80, _truth),
    ">=": _binary(80, _truth),
    "<": _binary(80, _truth),
    ">": _binary(80, _truth),
    ">>": _binary(90, lambda a, _: _wide(a.bits, a)),
    "<<": _binary(90, _shifted_left),
    "-": _binary(100, lambda a, b: Extent(bits=max(a.bits, b.bits) + 1, is_signed=True)),
    "+": _binary(100, lambda a, b: _wide(max(a.bits, b.bits) + 1, a, b)),
    "%": _binary(110, lambda a, b: _wide(min(a.bits, b.bits), a)),
    "/": _binary(110, lambda a, b: _wide(a.bits, a, b)),
    "*": _binary(110, lambda a, b: _wide(a.bits + b.bits, a, b)),
    "**": _Operation(precedence=120, operands=2, extent=_anything, is_from_right=True),
    "minus": _unary(130, _negated),
    "plus": _unary(130, lambda a: a),
    "~": _unary(130, lambda a: Extent(bits=a.bits + 1, is_signed=True)),
    **{
        name: _unary(200, lambda a: _wide(a.bits + 1, a))
        for name in ("trunc", "round", "floor", "ceil", "abs")
    },
    **{
        name: _unary(200, _anything)
        for name in ("sin", "cos", "atan", "tan", "exp", "ln", "lg", "sqrt", "asin", "acos")
    },
    "sgn": _unary(200, lambda _: Extent(bits=1, is_signed=True)),
    "neg": _unary(200, _negated),
}
"""Precedence and associativity as in Aravis' ``arvevaluator.c``."""

_TOKEN = re.compile(
    r"\s*(0[xX][0-9a-fA-F]+|\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|[A-Za-z_.][A-Za-z0-9_.]*"
    r"|\*\*|&&|\|\||<>|<<|>>|<=|>=|[-+*/%&|^~<>=?:(),])"
)
_UNARY = {"-": "minus", "+": "plus"}
_NO_OPERANDS = frozenset((*_OPERATIONS, "(", ","))


def _reverse_polish(formula: str) -> list[str]:
    """The tokens in the order of evaluation; all up to what cannot be read."""
    output: list[str] = []
    waiting: list[str] = []
    is_after_operand = False
    place = 0
    while (found := _TOKEN.match(formula, place)) is not None:
        place, symbol = found.end(), found[1]
        if symbol.lower() in _OPERATIONS:
            symbol = symbol.lower()
        if symbol in _UNARY and not is_after_operand:
            symbol = _UNARY[symbol]
        is_after_operand = symbol == ")" or symbol not in _NO_OPERANDS
        if symbol == "(":
            waiting.append(symbol)
        elif symbol in (")", ","):
            while waiting and waiting[-1] != "(":
                output.append(waiting.pop())
            if symbol == ")" and waiting:
                waiting.pop()
        elif symbol in _OPERATIONS:
            while waiting and waiting[-1] != "(" and _comes_first(waiting[-1], symbol):
                output.append(waiting.pop())
            waiting.append(symbol)
        else:
            output.append(symbol)
    return [*output, *(symbol for symbol in reversed(waiting) if symbol != "(")]


def _comes_first(waiting: str, symbol: str) -> bool:
    before, now = _OPERATIONS[waiting].precedence, _OPERATIONS[symbol].precedence
    return before > now if _OPERATIONS[symbol].is_from_right else before >= now
