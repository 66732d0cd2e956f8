"""Detectability of a change between two photographs from different distances: d' at one zoom.

``K = sigma^2 (I + U U^T) + K_artefact`` and ``s_z = U A_rz s`` give every observer's d' without
any random number. Every d' is an upper bound: exposure, registration, gloss, parallax, defocus
and motion are outside the model. ``docs/theory-detectability.md`` derives all of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from analysis.choices import OBSERVERS, Observer
from analysis.detectability.artefact import ArtefactTiles, artefact_tiles
from analysis.detectability.covariance import WindowCovariance
from analysis.detectability.error_sources import student_factor
from analysis.detectability.local import LocalChange
from analysis.detectability.observers import observer_templates
from analysis.detectability.pair import compared_pair
from analysis.detectability.scenario import Scenario
from analysis.detectability.sensitivity import CaptureResponse, DPrimeSlopes, mean_slopes
from simulation import Model
from simulation.arrays import FloatArray

_REPLICATES = 1000
_INTERVAL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrime:
    """Detectability index of contrast 1, with its 95 % interval over images and positions.

    ``scene_err`` is the standard error of its logarithm over images, widened by Student's quantile;
    ``slopes`` say how it follows errors of the capture, None where that was not asked for.
    """

    value: float
    low: float
    high: float
    scene_err: float
    slopes: DPrimeSlopes | None = None


def scene_artefact(
    scene_dn: FloatArray, scenario: Scenario, model: Model, zoom: float, tiles_per_side: int = 4
) -> ArtefactTiles:
    """Measure the artefact that one scene image makes, tile by tile.

    Parameters
    ----------
    scene_dn
        The image c, grey, shape ``(rows, cols)``, finite.
    scenario, model, zoom
        How the two images come about.
    tiles_per_side
        Tiles are what the bootstrap draws.

    Raises
    ------
    ValueError
        If the image is too small for the zoom and the window.
    """
    shape = scene_dn.shape[0], scene_dn.shape[1]
    pair = compared_pair(shape, scenario.psf, model, zoom, scenario.reference_zoom)
    return artefact_tiles(pair.artefact_of(scene_dn), scenario.window_px, tiles_per_side)


def d_primes(
    changes: Sequence[LocalChange],
    artefact: ArtefactTiles,
    noise_dn: float,
    observers: tuple[Observer, ...] = OBSERVERS,
    *,
    seed: int = 0,
    response: CaptureResponse | None = None,
) -> dict[Observer, DPrime]:
    """Detectability index of a signal of contrast 1, analytic in the noise.

    Parameters
    ----------
    changes
        The signal at several positions, from ``local_changes``; d' is the mean over them.
    artefact
        Artefact of the scene images, joined in a fixed order.
    noise_dn
        Standard deviation of the white noise in either image.
    observers
        Observers to evaluate.
    seed
        For the bootstrap over tiles. It keeps each observer's template, so that the interval is
        that of the observer trained on all of them.
    response
        What errors of the capture do, for the slopes.

    Raises
    ------
    ValueError
        If the noise is not positive.
    """
    if not (noise_dn > 0 and np.isfinite(noise_dn)):
        raise ValueError(f"noise_dn must be positive, got {noise_dn}")
    artefact_dn2 = artefact.autocovariance_dn2
    drawn = drawn_shares(artefact.pixels, seed)
    values: dict[Observer, list[float]] = {name: [] for name in observers}
    replicated: dict[Observer, FloatArray] = {name: np.zeros(_REPLICATES) for name in observers}
    slopes: dict[Observer, list[DPrimeSlopes]] = {name: [] for name in observers}
    for place, change in enumerate(changes):
        covariance = WindowCovariance(noise_dn**2, change.up_y, change.up_x, artefact_dn2)
        templates = observer_templates(change.signal, covariance, observers)
        for name, template in templates.items():
            seen = float(np.sum(template * change.signal))
            noise_dn2 = noise_dn**2 * change.noise_variance(template)
            sums = artefact.template_sums(template)
            whole = max(float(sums.sum() / artefact.pixels.sum()), 0.0)
            values[name].append(seen / np.sqrt(noise_dn2 + whole))
            # Sums of single tiles reach into their neighbours and may fall below zero.
            parts = np.maximum(drawn @ sums, 0.0)
            replicated[name] += seen / np.sqrt(noise_dn2 + parts) / len(changes)
            if response is not None:
                slopes[name].append(response.slopes(template, place, change, noise_dn2, whole))
    found: dict[Observer, DPrime] = {}
    for name in observers:
        low, high = interval_of(replicated[name])
        found[name] = DPrime(
            value=float(np.mean(values[name])),
            low=low,
            high=high,
            scene_err=scene_error(replicated[name], len(artefact.pixels)),
            slopes=mean_slopes(slopes[name]) if slopes[name] else None,
        )
    return found


def scene_error(replicated: FloatArray, tiles: int) -> float:
    """Standard error of ln d' from its bootstrap over so many tiles.

    The spread of resampled means is too small by sqrt((n - 1) / n), and uncertain itself: normal
    quantiles of the result are Student's.
    """
    if tiles < 2:
        return 0.0
    widened = sqrt(tiles / (tiles - 1)) * student_factor(tiles - 1)
    return float(np.std(np.log(replicated)) * widened)


def interval_of(replicated: FloatArray) -> tuple[float, float]:
    """Return the ends of the 95 % interval of bootstrap replicates."""
    low, high = np.percentile(replicated, _INTERVAL_PERCENT).tolist()
    return low, high


def drawn_shares(pixels: FloatArray, seed: int) -> FloatArray:
    """Weights of the tiles' sums in each bootstrap replicate, shape (replicates, tiles)."""
    tiles = len(pixels)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(tiles, np.full(tiles, 1.0 / tiles), size=_REPLICATES)
    return np.asarray(counts / (counts @ pixels)[:, None])


def d_prime_between(zooms: ArrayLike, d_primes: ArrayLike, zoom: ArrayLike) -> FloatArray:
    """Interpolate d' at any zoom, 1/d' linear between those computed; outside, the nearest one.

    The artefact of the alignment grows about as z - 1 and adds to the noise in quadrature, so that
    1/d' is much like a hyperbola, which bends upwards: its chord reads d' a little too low, where
    the chord of d' itself reads up to several times too much. A step just beyond zoom 1 is the
    exception; docs/theory-detectability.md has the figures.

    Parameters
    ----------
    zooms, d_primes
        What was computed: zooms in rising order, d' of 0 or more. Beside a d' of 0 it is 0 in the
        whole open interval: nothing says where it vanished.
    zoom
        Any shape; NaN gives NaN.
    """
    nodes, values = np.asarray(zooms, np.float64), np.asarray(d_primes, np.float64)
    within = np.clip(np.asarray(zoom, np.float64), nodes[0], nodes[-1])
    straight = np.interp(within, nodes, values)
    with np.errstate(divide="ignore", over="ignore"):  # a d' of 0, or next to it
        # Rounding must not lift it above the chord of d' itself.
        reciprocal = np.maximum(np.interp(within, nodes, 1 / values), 1 / straight)
    # 1 / (1 / d') is not always d', and a threshold may be a computed value.
    return np.asarray(np.where(np.isin(within, nodes), straight, 1 / reciprocal))
