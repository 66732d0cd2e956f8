"""Detectability of a change between two photographs from different distances: d' against zoom.

``K = sigma^2 (I + U U^T) + K_artefact`` and ``s_z = U A_rz s`` give every observer's d' without
any random number. Every d' is an upper bound: exposure, registration, gloss, parallax, defocus
and motion are outside the model. ``docs/theory-detectability.md`` derives all of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.detectability.artefact import ArtefactTiles, artefact_tiles
from analysis.detectability.covariance import WindowCovariance
from analysis.detectability.curves import DetectabilityCurve
from analysis.detectability.local import POSITIONS, WINDOW_PX, LocalChange, local_changes
from analysis.detectability.observers import OBSERVERS, Observer, auc_of, observer_templates
from analysis.detectability.pair import REFERENCE_ZOOM, compared_pair
from analysis.detectability.signal import ChangeSignal
from simulation import GaussianPsf, Model

__all__ = [
    "BOOTSTRAP_REPLICATES",
    "DPrime",
    "Scenario",
    "d_prime_curves",
    "d_primes",
    "scene_artefact",
]

FloatArray = NDArray[np.float64]

BOOTSTRAP_REPLICATES = 1000
_INTERVAL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """How the two images come about and through which window they are looked at.

    Parameters
    ----------
    psf
        Total PSF of c; ``bicubic`` needs none.
    reference_zoom
        From c to the reference c'.
    window_px
        Side of the observer's window on c', odd.
    positions
        Places of the signal against the pixel grids.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    psf: GaussianPsf | None
    reference_zoom: float = REFERENCE_ZOOM
    window_px: int = WINDOW_PX
    positions: int = POSITIONS

    def __post_init__(self) -> None:
        if not (self.reference_zoom >= 1 and np.isfinite(self.reference_zoom)):
            raise ValueError(f"reference_zoom must be at least 1, got {self.reference_zoom}")
        if self.window_px % 2 == 0 or self.window_px < 5:
            raise ValueError(f"window_px must be odd and at least 5, got {self.window_px}")
        if self.positions < 1:
            raise ValueError(f"positions must be at least 1, got {self.positions}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrime:
    """Detectability index of contrast 1, with its 95 % interval over images and positions."""

    value: float
    low: float
    high: float


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
    replicates: int = BOOTSTRAP_REPLICATES,
) -> dict[Observer, DPrime]:
    """Detectability index of a signal of contrast 1, analytic in the noise.

    Parameters
    ----------
    changes
        The signal at several places, from ``local_changes``; d' is the mean over them.
    artefact
        Of the scene images, joined in a fixed order.
    noise_dn
        Standard deviation of the white noise in either image.
    observers
        Which ones.
    seed, replicates
        Of the bootstrap over tiles. It keeps each observer's template, so that the interval is
        that of the observer trained on all of them.

    Raises
    ------
    ValueError
        If the noise is not positive.
    """
    if not (noise_dn > 0 and np.isfinite(noise_dn)):
        raise ValueError(f"noise_dn must be positive, got {noise_dn}")
    artefact_dn2 = artefact.autocovariance_dn2
    drawn = _drawn_shares(artefact.pixels, seed, replicates)
    values: dict[Observer, list[float]] = {name: [] for name in observers}
    replicated: dict[Observer, FloatArray] = {name: np.zeros(replicates) for name in observers}
    for change in changes:
        covariance = WindowCovariance(noise_dn**2, change.up_y, change.up_x, artefact_dn2)
        templates = observer_templates(change.signal, covariance, observers)
        for name, template in templates.items():
            response = float(np.sum(template * change.signal))
            noise_dn2 = noise_dn**2 * change.noise_variance(template)
            sums = artefact.template_sums(template)
            whole = max(float(sums.sum() / artefact.pixels.sum()), 0.0)
            values[name].append(response / np.sqrt(noise_dn2 + whole))
            # Sums of single tiles reach into their neighbours and may fall below zero.
            parts = np.maximum(drawn @ sums, 0.0)
            replicated[name] += response / np.sqrt(noise_dn2 + parts) / len(changes)
    intervals = {
        name: np.percentile(replicated[name], _INTERVAL_PERCENT).tolist() for name in observers
    }
    return {
        name: DPrime(
            value=float(np.mean(values[name])), low=intervals[name][0], high=intervals[name][1]
        )
        for name in observers
    }


def d_prime_curves(
    artefacts: Sequence[ArtefactTiles],
    zooms: Sequence[float],
    signal: ChangeSignal,
    scenario: Scenario,
    model: Model,
    *,
    noises_dn: Sequence[float],
    contrasts_dn: Sequence[float],
    observers: tuple[Observer, ...] = OBSERVERS,
    seed: int = 0,
) -> list[DetectabilityCurve]:
    """Curves of d' against zoom for every observer, noise and contrast.

    Parameters
    ----------
    artefacts
        One for each zoom, from ``scene_artefact`` of all images.
    zooms
        In rising order.
    signal, scenario, model, observers, seed
        What is looked for, in what, and how.
    noises_dn, contrasts_dn
        Standard deviations of the noise, peaks of the signal on c.
    """
    found: dict[tuple[Observer, float], list[DPrime]] = {}
    for zoom, artefact in zip(zooms, artefacts, strict=True):
        changes = local_changes(
            signal,
            scenario.psf,
            model,
            zoom,
            reference_zoom=scenario.reference_zoom,
            window_px=scenario.window_px,
            positions=scenario.positions,
        )
        for noise_dn in noises_dn:
            results = d_primes(changes, artefact, noise_dn, observers, seed=seed)
            for observer, result in results.items():
                found.setdefault((observer, noise_dn), []).append(result)
    return [
        _curve(
            found[observer, noise_dn],
            contrast_dn,
            {
                "model": model,
                "observer": observer,
                "noise_dn": noise_dn,
                "signal_sigma_px": signal.sigma_px,
                "zoom": list(zooms),
            },
        )
        for observer in observers
        for noise_dn in noises_dn
        for contrast_dn in contrasts_dn
    ]


def _curve(results: list[DPrime], contrast_dn: float, about: dict[str, Any]) -> DetectabilityCurve:
    # The noise does not depend on the signal: d' is proportional to the contrast.
    values = [contrast_dn * result.value for result in results]
    return DetectabilityCurve(
        **about,
        contrast_dn=contrast_dn,
        dprime=values,
        dprime_low=[contrast_dn * result.low for result in results],
        dprime_high=[contrast_dn * result.high for result in results],
        auc=auc_of(np.array(values)).tolist(),
    )


def _drawn_shares(pixels: FloatArray, seed: int, replicates: int) -> FloatArray:
    """Weights of the tiles' sums in each bootstrap replicate, shape (replicates, tiles)."""
    tiles = len(pixels)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(tiles, np.full(tiles, 1.0 / tiles), size=replicates)
    return np.asarray(counts / (counts @ pixels)[:, None])
