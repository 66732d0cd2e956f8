import numpy as np
import pytest

from simulation.uncertainty import second_derivatives


def test_the_derivatives_of_a_cosine_are_those_of_the_formula() -> None:
    # Whole half periods along either axis, as the mirror at the edges has them; not square.
    y, x = np.mgrid[0:40, 0:60] + 0.5
    a, b = np.pi * 7 / 60, np.pi * 5 / 40
    xx, xy, yy = second_derivatives(np.cos(a * x) * np.cos(b * y))
    assert xx == pytest.approx(-(a**2) * np.cos(a * x) * np.cos(b * y), abs=1e-12)
    assert yy == pytest.approx(-(b**2) * np.cos(a * x) * np.cos(b * y), abs=1e-12)
    assert xy == pytest.approx(a * b * np.sin(a * x) * np.sin(b * y), abs=1e-12)


def test_colours_are_taken_one_by_one() -> None:
    planes = np.random.default_rng(0).normal(size=(9, 12, 3))
    whole = second_derivatives(planes)
    for k in range(3):
        for all_planes, plane in zip(whole, second_derivatives(planes[:, :, k]), strict=True):
            assert all_planes[:, :, k] == pytest.approx(plane, abs=1e-12)
