"""Lateral chromatic aberration over the field, from the shifts across the edges.

An edge tells the shift of red or blue from green across itself only. Over the field the shift is
that of an image of another size, decentred, with a part of third order:
``d(r) = t + m r + k r |r|^2``, with r from the middle of the picture in half diagonals. Its four
terms are fitted to all edges at once, whose directions tell both components.
"""

from collections.abc import Sequence
from math import hypot
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.stats import chi2 as chi_squared

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from calibration.sharpness import MeasuredValue, Picture
from simulation.arrays import FloatArray

_COLOURS: Final = ("red", "blue")
_TERMS = 4
_FEWEST = 8
_GRID = (5, 4)
_CHANCE = 0.01
_LARGEST_RATIO = 1e4


class ShiftVector(StoredModel):
    """Shift of a colour from green at a place: to the right, down, and the error of either."""

    x_px: float
    y_px: float
    right_px: float
    down_px: float
    err_px: float


class LateralColourField(StoredModel):
    """Shift of a colour from green over the field that the edges cover.

    ``worst`` is the largest shift of ``vectors``, of which the first 20 are a grid over the picture
    between the outermost edges. ``is_found`` says whether there is any beyond chance (1 % of lenses
    without); ``growth`` is the difference in size of the two images, 1 being the picture.
    """

    colour: Literal["red", "blue"]
    edges: int
    is_found: bool
    worst: ShiftVector
    worst_px: MeasuredValue
    growth: MeasuredValue
    vectors: tuple[ShiftVector, ...]

    @property
    def sentence(self) -> str:
        """What the field shows."""
        most = self.worst_px.estimate.text(3)
        if not self.is_found:
            return f"{self.colour.capitalize()}: none beyond its error; at most {most} px."
        return (
            f"{self.colour.capitalize()}: {most} px from green at the worst point of the field, "
            f"({self.worst.x_px:.0f}, {self.worst.y_px:.0f})."
        )


def lateral_fields(
    edges: Sequence[EdgeMeasurement], picture: Picture
) -> tuple[LateralColourField, ...]:
    """Return the shifts of red and of blue over the field.

    Empty without colours, of fewer than eight edges, and where edges do not tell both components.
    """
    if picture.width_px is None or picture.height_px is None:
        return ()
    size = picture.width_px, picture.height_px
    found = (_field_of(edges, colour, size) for colour in _COLOURS)
    return tuple(one for one in found if one is not None)


class _Fit(NamedTuple):
    terms: FloatArray
    covariance: FloatArray


def _field_of(
    edges: Sequence[EdgeMeasurement], colour: Literal["red", "blue"], size: tuple[int, int]
) -> LateralColourField | None:
    known = [
        (edge.x_px, edge.y_px, edge.normal_rad, *shift)
        for edge in edges
        if (shift := _outward(edge, colour, size)) is not None
    ]
    if len(known) < _FEWEST:
        return None
    x, y, normal, shift, err = np.array(known).T
    basis = _basis(x, y, size)
    across = (np.cos(normal)[:, None] * basis[0] + np.sin(normal)[:, None] * basis[1]) / err[
        :, None
    ]
    scaled = np.linalg.svd(across, compute_uv=False)
    if scaled[0] > _LARGEST_RATIO * scaled[-1]:
        return None
    covariance = np.linalg.inv(across.T @ across)
    terms = covariance @ across.T @ (shift / err)
    left = float(np.sum((shift / err - across @ terms) ** 2)) / (len(known) - _TERMS)
    fit = _Fit(terms, covariance * max(left, 1.0))
    explained = float(terms @ np.linalg.solve(fit.covariance, terms))
    grid = np.meshgrid(
        np.linspace(x.min(), x.max(), _GRID[0]), np.linspace(y.min(), y.max(), _GRID[1])
    )
    vectors = _vectors(fit, grid[0].ravel(), grid[1].ravel(), size)
    worst = max(vectors, key=lambda one: hypot(one.right_px, one.down_px))
    half = 0.5 * hypot(size[0] - 1, size[1] - 1)
    return LateralColourField(
        colour=colour,
        edges=len(known),
        is_found=bool(explained > chi_squared.isf(_CHANCE, _TERMS)),
        worst=worst,
        worst_px=MeasuredValue(value=hypot(worst.right_px, worst.down_px), err=worst.err_px),
        growth=MeasuredValue(
            value=float(terms[2]) / half, err=float(np.sqrt(fit.covariance[2, 2])) / half
        ),
        vectors=vectors,
    )


def _outward(
    edge: EdgeMeasurement, colour: str, size: tuple[int, int]
) -> tuple[float, float] | None:
    """Shift along the normal as ``normal_rad`` points, and its error.

    An edge states it positive away from the centre.
    """
    shift, err = (getattr(edge, f"{colour}_shift_{end}") for end in ("px", "err_px"))
    if shift is None or not err:
        return None
    right, down = edge.x_px - (size[0] - 1) / 2, edge.y_px - (size[1] - 1) / 2
    along = right * np.cos(edge.normal_rad) + down * np.sin(edge.normal_rad)
    return (shift if along >= 0 else -shift), err


def _basis(x: FloatArray, y: FloatArray, size: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """What each term shifts at places: to the right, and down."""
    half = 0.5 * hypot(size[0] - 1, size[1] - 1)
    right, down = (x - (size[0] - 1) / 2) / half, (y - (size[1] - 1) / 2) / half
    square, one, none = right**2 + down**2, np.ones_like(right), np.zeros_like(right)
    return (
        np.column_stack([one, none, right, square * right]),
        np.column_stack([none, one, down, square * down]),
    )


def _vectors(
    fit: _Fit, x: FloatArray, y: FloatArray, size: tuple[int, int]
) -> tuple[ShiftVector, ...]:
    along = _basis(x, y, size)
    variance = sum(np.einsum("ij,jk,ik->i", one, fit.covariance, one) for one in along)
    right, down = (one @ fit.terms for one in along)
    return tuple(
        ShiftVector(x_px=a, y_px=b, right_px=c, down_px=d, err_px=e)
        for a, b, c, d, e in np.column_stack([x, y, right, down, np.sqrt(variance / 2)]).tolist()
    )
