"""The source of the simulated GigE camera's frames, which tests can query as well."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from hil_mocks.scene import ADC_MAX_DN, Sensor

NOISE_LEVELS = 65536
CERTAIN_SIGMA = 8.0
"""Beyond this many standard deviations the full well no longer matters in float32."""

BAYER_WEIGHTS = {"R": 0.55, "G": 1.0, "B": 0.7}
"""Transmission of a colour filter for white paper, relative to green (our choice)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRequest:
    """Everything that a frame depends on except the scene.

    Parameters
    ----------
    acquisition
        Number of the acquisition start since power-up, from 1.
    index
        Number of the frame since that start, from 0: the block id is ``index + 1`` until ids wrap.
    exposure_us, gain_db, black_level_dn
        Settings of the camera; the black level in DN at 12 bits.
    """

    acquisition: int
    index: int
    exposure_us: float
    gain_db: float
    black_level_dn: float


class FrameSource(Protocol):
    """Makes a camera's frames; while the scene is still, each depends only on its request."""

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the sensor."""
        ...

    def levels_dn(self, request: FrameRequest) -> NDArray[np.uint16]:
        """Levels of the whole sensor in DN at 12 bits."""
        ...


@cache
def noise_table() -> NDArray[np.float32]:
    """Standard normal deviate for each of 65536 equally likely draws: mean 0, variance 1.

    The largest is 4.2: the tails beyond, 3 in 100 000 draws, are pulled in.
    """
    quantiles = ndtri((np.arange(NOISE_LEVELS) + 0.5) / NOISE_LEVELS)
    table = np.asarray(quantiles / quantiles.std(), np.float32)
    table.setflags(write=False)
    return table


class BenchFrameSource:
    """Photographs the view of a simulated bench, with noise according to the sensor model.

    Every pixel of every frame draws 16 random bits of its own, a normal deviate by `noise_table`:
    shot and read noise together are a Gaussian of the model's variance. So mean and variance are
    the model's down to a few electrons, but the skewness of the Poisson distribution is missing.
    The clipping by the full well is included in the mean and the variance of its pixels.

    Parameters
    ----------
    sensor
        The sensor model.
    look
        Present light on each pixel, relative to white paper; the same array while nothing moves.
    seed
        Seed of the noise.
    bayer_order
        First two colours of the mosaic, such as ``RG``; None for a monochrome sensor.
    """

    def __init__(
        self,
        sensor: Sensor,
        look: Callable[[], NDArray[np.float32]],
        *,
        seed: int,
        bayer_order: str | None = None,
    ) -> None:
        self._sensor = sensor
        self._look = look
        self._seed = seed
        view = look()
        self._shape = (view.shape[0], view.shape[1])
        self._filter = None if bayer_order is None else _mosaic(self._shape, bayer_order)
        self._prepared: _Prepared | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """See `FrameSource.shape`."""
        return self._shape

    def levels_dn(self, request: FrameRequest) -> NDArray[np.uint16]:
        """See `FrameSource.levels_dn`; the scene is read once, at the start."""
        view = self._look()
        prepared = self._prepared
        settings = (request.exposure_us, request.gain_db, request.black_level_dn)
        if prepared is None or prepared.view is not view or prepared.settings != settings:
            prepared = self._prepare(view, request)
            self._prepared = prepared
        stream = np.random.SFC64([self._seed, request.acquisition, request.index])
        draws = stream.random_raw(-(-view.size // 4)).view(np.uint16)[: view.size]
        level_dn = np.take(noise_table(), draws, mode="clip").reshape(view.shape)
        level_dn *= prepared.sigma_dn
        level_dn += prepared.mean_dn  # plus a half, as the conversion below truncates
        np.clip(level_dn, 0, ADC_MAX_DN, out=level_dn)
        return level_dn.astype(np.uint16)

    def _prepare(self, view: NDArray[np.float32], request: FrameRequest) -> "_Prepared":
        electrons = self._sensor.electrons(view, request.exposure_us).astype(np.float64)
        if self._filter is not None:
            electrons *= self._filter
        mean_e, variance_e2 = _filled(electrons, self._sensor.full_well_e)
        gain = self._sensor.gain_at_e_per_dn(request.gain_db)
        sigma_e = np.sqrt(variance_e2 + self._sensor.read_noise_e**2)
        return _Prepared(
            view=view,
            settings=(request.exposure_us, request.gain_db, request.black_level_dn),
            mean_dn=(request.black_level_dn + 0.5 + mean_e / gain).astype(np.float32),
            sigma_dn=(sigma_e / gain).astype(np.float32),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Prepared:
    view: NDArray[np.float32]
    settings: tuple[float, float, float]
    mean_dn: NDArray[np.float32]
    sigma_dn: NDArray[np.float32]


def _filled(
    electrons: NDArray[np.float64], full_well_e: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and variance of ``min(X, full well)`` with X normal, mean and variance ``electrons``."""
    sigma = np.sqrt(np.maximum(electrons, 1e-6))
    room = np.clip((full_well_e - electrons) / sigma, -CERTAIN_SIGMA, CERTAIN_SIGMA)
    if room.min() >= CERTAIN_SIGMA:
        return electrons, electrons
    below, density = ndtr(room), np.exp(-(room**2) / 2) / np.sqrt(2 * np.pi)
    # E[min(Z, a)] and E[min(Z, a)^2] of a standard normal Z.
    first = room * (1 - below) - density
    second = below - room * density + room**2 * (1 - below)
    mean = np.where(room <= -CERTAIN_SIGMA, full_well_e, electrons + sigma * first)
    return mean, np.maximum(second - first**2, 0) * sigma**2


def _mosaic(shape: tuple[int, int], order: str) -> NDArray[np.float64]:
    """Weight of each pixel's colour filter; ``order`` is the first row's first two colours."""
    other = "B" if "R" in order else "R"
    second = ("G" + other) if order[1] == "G" else (other + "G")
    weights = np.array([[BAYER_WEIGHTS[colour] for colour in row] for row in (order, second)])
    return np.tile(weights, (shape[0] // 2 + 1, shape[1] // 2 + 1))[: shape[0], : shape[1]]
