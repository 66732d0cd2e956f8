"""Arrays of other libraries, and quantities with units."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    accepted,
    given_array,
    whole_array,
)

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
