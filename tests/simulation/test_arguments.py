"""Arguments by their annotations, arrays of other libraries, and quantities with units."""

import pickle
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    accepted,
    arguments_at_fault,
    checked,
    given_array,
    whole_array,
)
from simulation.arguments._errors import RANGES, _Range

Shape = Literal["best", "measured"]
PAIRS = tuple[int, int]


@pytest.mark.parametrize(
    ("name", "value", "hint", "expected"),
    [
        ("zoom", 2, float, 2),
        ("zoom", np.float32(1.5), float | None, 1.5),
        ("zoom", Fraction(3, 2), float, 1.5),
        ("zoom", np.array(1.5), float, 1.5),
        ("zoom", None, float | None, None),
        ("steps", 3.0, int, 3),
        ("steps", np.int16(3), int, 3),
        ("transfer", "best", Shape, "best"),
        ("zooms", [1, 2], tuple[float, ...], (1, 2)),
        ("zooms", np.array([1.0, 2.0]), tuple[float, ...], (1.0, 2.0)),
        ("size", [3, 4], PAIRS | None, (3, 4)),
        ("models", ["best"], Iterable[Shape] | None, ["best"]),
        ("mirrored", np.True_, bool, True),
        ("path", Path("a"), str | Path, Path("a")),
        ("settings", {"a": 1}, Mapping[str, Any] | None, {"a": 1}),
        ("anything", 1j, Any, 1j),
    ],
)
def test_what_is_meant_is_taken(name: str, value: object, hint: object, expected: object) -> None:
    found = accepted(name, value, hint)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("name", "value", "hint", "said"),
    [
        ("zoom", 0, float, "zoom: expected a number above 0, got 0"),
        ("zoom", float("nan"), float, "zoom: expected a number above 0, got nan"),
        ("zoom", float("inf"), float | None, "zoom: expected a number above 0, got inf"),
        ("steps", 2.5, int, "steps: expected a whole number from 1 on, got 2.5"),
        ("seed", -1, int, "seed: expected a whole number from 0 on, got -1"),
        ("pixel_pitch_um", 0.00345, float, "pixel_pitch_um: expected a number from 0.1 up to 1000"),
        ("transfer", "mesured", Shape, "measured was probably meant"),
        ("models", ("mesured",), tuple[Shape, ...], "models: expected best or measured"),
        ("noises_dn", (-2.0,), tuple[float, ...], "noises_dn: expected a number from 0 on, got -2"),
        ("zooms", (), tuple[float, ...], "zooms: expected at least one value"),
        (
            "zooms",
            (1.0, "2"),
            tuple[float, ...],
            "one of its values: expected a number, got str",
        ),
        ("size", (1, 2, 3), PAIRS, "size: expected 2 values, got 3"),
        ("zoom", np.ma.masked, float, "zoom: expected a number, got one that is masked"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(
    name: str, value: object, hint: object, said: str
) -> None:
    with pytest.raises(ArgumentError) as refused:
        accepted(name, value, hint)
    assert said in str(refused.value)
    assert refused.value.argument == name
    assert not isinstance(refused.value, TypeError)


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        ("2", float),
        (True, float),
        (1j, float | None),
        (1, bool),
        (2.5, str | Path),
        ("best", tuple[Shape, ...]),
        ("best", Iterable[Shape] | None),
        ({"a": 1}, Iterable[str]),
        (3, Callable[[int], int]),
        (3, Mapping[str, Any] | None),
        ("a", NDArray[np.float64]),
        (None, float),
    ],
)
def test_another_type_is_both_kinds_of_error(value: object, hint: object) -> None:
    with pytest.raises(ArgumentTypeError, match=r"^it: expected .*, got") as refused:
        accepted("it", value, hint)
    assert isinstance(refused.value, TypeError)
    assert isinstance(refused.value, ValueError)


def test_arrays_become_those_of_the_annotation_and_masked_ones_are_refused() -> None:
    found = accepted("matrix", [[1, 0], [0, 1]], NDArray[np.float64])
    assert found.dtype == np.float64
    assert accepted("left_out", np.eye(2), NDArray[np.bool_]).dtype == np.bool_
    with pytest.raises(ArgumentError, match="masked"):
        accepted("matrix", np.ma.masked_equal([1.0, 2.0], 2.0), NDArray[np.float64])


def test_a_function_is_checked_at_each_call_and_looks_as_before() -> None:
    @checked
    def made(zoom: float, *, transfer: Shape = "best") -> tuple[float, str]:
        """Make."""
        return zoom, transfer

    assert made(2.0, transfer="measured") == (2.0, "measured")
    assert made.__doc__ == "Make."
    with pytest.raises(ArgumentError, match="transfer"):
        made(2.0, transfer="mesured")  # type: ignore[arg-type]  # the point
    with pytest.raises(TypeError, match="unexpected keyword argument 'zom'"):
        made(zom=2.0)  # type: ignore[call-arg]  # the point


def test_only_what_pure_functions_refuse_becomes_an_argument_error() -> None:
    with pytest.raises(ArgumentError, match="too small"), arguments_at_fault():
        raise ValueError("too small")
    with pytest.raises(UnicodeError), arguments_at_fault():
        b"\xff".decode()


def test_an_error_keeps_its_argument_in_another_process() -> None:
    again = pickle.loads(pickle.dumps(ArgumentError("expected more", argument="zoom")))
    assert (str(again), again.argument, again.reason) == (
        "zoom: expected more",
        "zoom",
        "expected more",
    )


def test_ranges_hold_their_ends_but_where_they_are_open() -> None:
    assert _Range(0, 1).holds(0)
    assert _Range(0, 1).holds(1)
    assert not _Range(0, 1, is_open=True).holds(0)
    for one in RANGES.values():
        assert not one.holds(float("nan"))
        assert not one.holds(float("inf"))


LEVELS = np.arange(12.0).reshape(3, 4)
MASK = LEVELS > 9


class Held:
    """What holds an array as numpy asks for it, and nothing else."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray[Any, Any]:
        return LEVELS


class Labelled(Held):
    """As of xarray: dimensions, attributes, and the array below."""

    dims = ("y", "x")
    data = LEVELS

    def __init__(self, units: str | None = None) -> None:
        self.attrs = {} if units is None else {"units": units}


class Column:
    """As of polars before it had ``__array__``."""

    def to_numpy(self) -> np.ndarray[Any, Any]:
        return LEVELS


class Quantity(SimpleNamespace):
    """As of pint: a magnitude and its units, which its array would lose."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray[Any, Any]:
        raise AssertionError("the unit would be lost")

    def to(self, unit: str) -> "Quantity":
        factors = {("mm", "um"): 1000.0, ("um", "um"): 1.0, ("pixel", "pixel"): 1.0}
        return Quantity(magnitude=self.magnitude * factors[self.units, unit], units=unit)


def torch() -> object:
    return pytest.importorskip("torch").tensor(LEVELS, requires_grad=True)


def dask() -> object:
    return pytest.importorskip("dask.array").from_array(LEVELS)


def pandas() -> object:
    return pytest.importorskip("pandas").DataFrame(LEVELS)


def astropy() -> object:
    return LEVELS * pytest.importorskip("astropy.units").adu


@pytest.mark.parametrize(
    "made",
    [
        LEVELS.tolist,
        Held,
        Labelled,
        lambda: Labelled("DN"),
        Column,
        torch,
        dask,
        pandas,
        astropy,
        lambda: Quantity(magnitude=LEVELS, units="count"),
    ],
)
def test_whatever_holds_an_array_gives_its_numbers(made: Any) -> None:
    found = given_array(made(), "image")
    assert np.array_equal(found.values, LEVELS)
    assert found.masked is None


def masked_data() -> object:
    nddata = pytest.importorskip("astropy.nddata")
    return nddata.CCDData(LEVELS, mask=MASK, unit="adu")


def masked_quantity() -> object:
    masked = pytest.importorskip("astropy.utils.masked")
    return masked.Masked(astropy(), mask=MASK)


def masked_chunks() -> object:
    return pytest.importorskip("dask.array").from_array(np.ma.array(LEVELS, mask=MASK))


@pytest.mark.parametrize(
    "made",
    [
        lambda: np.ma.array(LEVELS, mask=MASK),
        masked_data,
        masked_quantity,
        masked_chunks,
        lambda: Quantity(magnitude=np.ma.array(LEVELS, mask=MASK), units="dn"),
    ],
)
def test_a_mask_is_not_lost(made: Any) -> None:
    found = given_array(made(), "image")
    assert found.masked is not None
    assert np.array_equal(found.masked, MASK)
    with pytest.raises(ArgumentError, match="image: 2 of its 12 numbers are masked"):
        whole_array(made(), "image")


@pytest.mark.parametrize(
    "made", [lambda: Quantity(magnitude=LEVELS, units="W"), lambda: Labelled("m")]
)
def test_levels_in_another_unit_are_refused(made: Any) -> None:
    with pytest.raises(ArgumentError, match="image: its unit is"):
        given_array(made(), "image")


@pytest.mark.parametrize(
    "value", [3, "a.tif", None, {"a": 1}, [[1, 2], [3]], ["a"], np.array(["a"]), np.array([1j])]
)
def test_what_holds_no_numbers_is_refused(value: object) -> None:
    with pytest.raises(ArgumentTypeError, match=r"^image: "):
        given_array(value, "image")


def test_a_quantity_comes_in_the_unit_of_the_name_or_not_at_all() -> None:
    assert accepted(
        "pixel_pitch_um", Quantity(magnitude=0.00345, units="mm"), float
    ) == pytest.approx(3.45)
    assert accepted("sigma_px", Quantity(magnitude=0.7, units="pixel"), float) == 0.7
    with pytest.raises(ArgumentError, match=r"pixel_pitch_um: .* in um, got one in s"):
        accepted("pixel_pitch_um", Quantity(magnitude=1.0, units="s"), float)
    with pytest.raises(ArgumentError, match="zoom: expected a number without a unit"):
        accepted("zoom", Quantity(magnitude=2.0, units="mm"), float)


def test_a_quantity_of_astropy_is_converted() -> None:
    units = pytest.importorskip("astropy.units")
    assert accepted("pixel_pitch_um", 3.45e-6 * units.m, float) == pytest.approx(3.45)
    assert accepted("height_mm", 30 * units.cm, float) == pytest.approx(300)
    assert accepted("zooms", [1, 2] * units.dimensionless_unscaled, tuple[float, ...]) == (1, 2)
