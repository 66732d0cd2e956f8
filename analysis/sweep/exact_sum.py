"""Sums of arrays without any rounding: the same in every order, and of sums of parts."""

from collections.abc import Iterable

import numpy as np

from simulation.arrays import FloatArray


class ExactSum:
    """The exact sum of finite float64 arrays of one shape, as terms that do not overlap.

    References
    ----------
    J. R. Shewchuk, Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
    Predicates, 1997, section 2.
    """

    def __init__(self, terms: Iterable[FloatArray] = ()) -> None:
        self._terms: list[FloatArray] = []
        for term in terms:
            self.add(term)

    def add(self, values: FloatArray) -> None:
        """Add an array, whose terms of no account go to further ones."""
        for number, term in enumerate(self._terms):
            self._terms[number], values = _two_sum(term, values)
        if not self._terms or values.any():
            self._terms.append(values)

    def terms(self) -> list[FloatArray]:
        """Return arrays whose sum is the exact one, each below the last bits of the one before."""
        terms = list(self._terms)
        is_changing = True
        while is_changing:
            is_changing = False
            for number in range(len(terms) - 1, 0, -1):
                upper, lower = _two_sum(terms[number - 1], terms[number])
                is_changing |= not np.array_equal(upper, terms[number - 1], equal_nan=True)
                terms[number - 1], terms[number] = upper, lower
        while len(terms) > 1 and not terms[-1].any():
            terms.pop()
        return terms

    def rounded(self) -> FloatArray:
        """Return the float64 nearest to each sum; of two as near the even one."""
        first, *rest = self.terms()
        if len(rest) < 2:  # of two terms the first is the nearest
            return first
        # Half of a last bit was rounded to even, but what follows it decides.
        twice = 2 * rest[0]
        further = first + twice
        is_further = (rest[0] * rest[1] > 0) & (further - first == twice)
        return np.where(is_further, further, first)


def on_own_grid(values: FloatArray) -> FloatArray:
    """Round to the last bits of the largest of each last two axes, so that sums have few terms."""
    largest = np.abs(values).max(axis=(-2, -1), keepdims=True)
    shift = np.ldexp(3.0, np.frexp(largest)[1])
    return np.asarray((values + shift) - shift)


def _two_sum(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rounded sum, and exactly what rounding took from it; D. E. Knuth, 1969, 4.2.2."""
    rounded = one + other
    of_other = rounded - one
    return rounded, (one - (rounded - of_other)) + (other - of_other)
