"""The difference image around a change: what is left of the signal, and the noise's covariance."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np

from analysis.detectability.pair import ComparedPair, compared_pair, frame_size_px
from analysis.detectability.scenario import Scenario
from analysis.detectability.signal import ChangeSignal, signal_offsets_px
from simulation import Model
from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalChange:
    """A signal of contrast 1 at one position on the pixel grids, in a window on c'.

    Parameters
    ----------
    signal
        ``U A_rz s``, shape (n, n).
    up_y, up_x
        Rows of ``U`` for the window, shape (n, follow-up pixels).
    """

    signal: FloatArray
    up_y: FloatArray
    up_x: FloatArray

    def noise_variance(self, template: FloatArray) -> float:
        """Variance of a template's response to noise of variance 1 in both images."""
        through = self.up_y.T @ template @ self.up_x
        return float(np.sum(template**2) + np.sum(through**2))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlacedSignal:
    """A signal at several positions on the pixel grids, and the pair that sees it.

    ``offsets_px`` are those from the middle of a square scene of ``side_px``, ``(y, x)``;
    ``windows`` are around them on c'.
    """

    signal: ChangeSignal
    pair: ComparedPair
    side_px: int
    offsets_px: tuple[tuple[int, int], ...]
    windows: tuple[tuple[slice, slice], ...]

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the scene."""
        return self.side_px, self.side_px

    def scenes(self) -> Iterator[tuple[FloatArray, tuple[slice, slice]]]:
        """Scene with the signal at each position, and the window around it."""
        for offset_px, window in zip(self.offsets_px, self.windows, strict=True):
            yield self.signal.image(self.side_px, offset_px), window


def placed_signal(
    signal: ChangeSignal, scenario: Scenario, model: Model, zoom: float
) -> PlacedSignal:
    """Place a signal on the pixel grids of a pair.

    Parameters
    ----------
    signal
        On the grid of c.
    scenario, model, zoom
        How the two images come about.

    Raises
    ------
    ValueError
        If the signal is wider than the window.
    """
    window_px, reference_zoom = scenario.window_px, scenario.reference_zoom
    if 2 * signal.reach_px / reference_zoom > window_px:
        raise ValueError(
            f"a signal of {2 * signal.reach_px / reference_zoom:.0f} px on the reference is wider "
            f"than the window of {window_px} px"
        )
    period_px = reference_zoom * zoom
    farthest = signal.reach_px + 4 * ceil(period_px)
    side = frame_size_px(scenario.psf, farthest, window_px, zoom, reference_zoom)
    pair = compared_pair((side, side), scenario.psf, model, zoom, reference_zoom)
    offsets = signal_offsets_px(scenario.positions, period_px)
    rows_px, cols_px = pair.reference_grid.rows_px, pair.reference_grid.cols_px
    windows = tuple(
        (
            _window(rows_px, side // 2 + offset_y, window_px),
            _window(cols_px, side // 2 + offset_x, window_px),
        )
        for offset_y, offset_x in offsets
    )
    return PlacedSignal(signal=signal, pair=pair, side_px=side, offsets_px=offsets, windows=windows)


def local_changes(
    signal: ChangeSignal, scenario: Scenario, model: Model, zoom: float
) -> tuple[LocalChange, ...]:
    """Work out what is left of a signal at several positions on the pixel grids.

    Parameters, errors: see `placed_signal`.
    """
    placed = placed_signal(signal, scenario, model, zoom)
    up_y, up_x = placed.pair.up_y.dense(), placed.pair.up_x.dense()
    return tuple(
        LocalChange(
            signal=placed.pair.aligned_of(scene)[rows, cols],
            up_y=_used(up_y[rows]),
            up_x=_used(up_x[cols]),
        )
        for scene, (rows, cols) in placed.scenes()
    )


def _window(positions_px: FloatArray, centre_px: float, window_px: int) -> slice:
    nearest = int(np.argmin(np.abs(positions_px - centre_px)))
    return slice(nearest - window_px // 2, nearest + window_px // 2 + 1)


def _used(rows: FloatArray) -> FloatArray:
    return np.ascontiguousarray(rows[:, np.any(rows != 0.0, axis=0)])
