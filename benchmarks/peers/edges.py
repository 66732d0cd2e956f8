"""Contrast by frequency across slanted edges, as other programs measure it."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.optimize import OptimizeWarning, curve_fit
from scipy.special import ndtr

from benchmarks.peers.program import (
    CONTRAST_FREQ_CY_PER_PX,
    EdgeContrast,
    PeerError,
    Program,
    Task,
)
from calibration.edges import (
    BinnedEdge,
    EdgeSamples,
    bin_edge,
    edge_samples,
    esfr_half_width_px,
    find_edges,
    fit_edge,
    gaussian_mtf50,
)
from simulation.arrays import FloatArray

_OVERSAMPLING = 4
"""Bins a pixel, of ISO 12233."""

_SMALLEST_SIGMA_PX = 0.05
_SMOOTHING_PX = 3
_FEWEST_PX = 30


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """Contrast at frequencies that rise from 0, in cycles/px; 1 at the first."""

    freq: FloatArray
    contrast: FloatArray

    @property
    def mtf50(self) -> float | None:
        """Frequency at which the contrast first falls to a half; None if it does not."""
        below = np.flatnonzero(self.contrast < 0.5)
        if below.size == 0 or below[0] == 0:
            return None
        part = slice(int(below[0]) - 1, int(below[0]) + 1)
        return float(np.interp(-0.5, -self.contrast[part], self.freq[part]))

    def answer(self, edge: str) -> EdgeContrast:
        """The contrasts that the benchmark asks for."""
        at = np.interp(CONTRAST_FREQ_CY_PER_PX, self.freq, self.contrast)
        return EdgeContrast(edge=edge, mtf50=self.mtf50, contrasts=tuple(at.tolist()))


def samples_of(image: FloatArray) -> tuple[EdgeSamples, BinnedEdge]:
    """Samples about the longest edge of an image, by distance from its fitted line."""
    segments = find_edges(image)
    fit = fit_edge(image, segments[0]) if segments else None
    if fit is None:
        raise PeerError("no edge")
    samples = edge_samples(image, segments[0], fit, esfr_half_width_px(fit.sigma_px))
    binned = bin_edge(samples, fit)
    if binned is None:
        raise PeerError("too few samples")
    return samples, binned


def curve_by_bins(samples: EdgeSamples) -> Curve:
    """ISO 12233:2017, annex D: bins of 1/4 px, central difference, Hann window, FFT."""
    place = np.round(samples.distance_px * _OVERSAMPLING).astype(int)
    place -= place.min()
    count = np.bincount(place)
    used = count > 0
    level = np.bincount(place, samples.unit_levels)[used] / count[used]
    edge = np.interp(np.arange(count.size), np.flatnonzero(used), level)
    spread = np.gradient(edge) * np.hanning(edge.size)
    mtf = np.abs(np.fft.rfft(spread, 4096))
    freq = np.asarray(np.fft.rfftfreq(4096, 1 / _OVERSAMPLING), dtype=np.float64)
    mtf /= mtf[0] * np.maximum(np.sinc(freq / 2), 0.1)
    return Curve(freq=freq, contrast=mtf)


def quick_mtf(image: FloatArray) -> Curve:
    """Curve of quickMTF, with four bins a pixel; its own figure is rounded to a hundredth."""
    peer = importlib.import_module("quickMTF.quickMTF").quickMTF().sfr_mtf_calculator
    try:
        made, _ = peer.calc_sfr(image, oversampling=_OVERSAMPLING)
    except (ValueError, TypeError, IndexError, np.linalg.LinAlgError) as error:
        raise PeerError(f"quickMTF: {error}") from error
    if made is False or not np.isfinite(made).all():
        raise PeerError("quickMTF finds no slanted edge")
    freq, contrast = np.asarray(made, dtype=np.float64).T
    return Curve(freq=freq, contrast=contrast)


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianEdge:
    """Width of the PSF across an edge if it is a Gaussian, and its standard error, in px."""

    sigma_px: float
    sigma_err_px: float

    def answer(self, edge: str) -> EdgeContrast:
        """The contrasts of such a PSF, pixel included."""
        freq = np.array(CONTRAST_FREQ_CY_PER_PX)
        contrast = np.exp(-2 * (np.pi * self.sigma_px * freq) ** 2)
        mtf50 = gaussian_mtf50(self.sigma_px)
        return EdgeContrast(
            edge=edge,
            mtf50=mtf50,
            mtf50_standard_error=mtf50 * self.sigma_err_px / self.sigma_px,
            contrasts=tuple(contrast.tolist()),
        )


def fit_gaussian_edge(image: FloatArray, angle_deg: float, task: Task) -> GaussianEdge:
    """Fit an edge behind a Gaussian to all pixels of an image, weighted by the task's noise.

    ``angle_deg`` is the direction of the edge line, to a degree.
    """
    rows, cols = image.shape
    if image.size < _FEWEST_PX:
        raise PeerError("the region is too small")
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    y, x = y.ravel() - (rows - 1) / 2, x.ravel() - (cols - 1) / 2

    def modelled(
        _: FloatArray, one: float, step: float, offset: float, turn: float, sigma: float
    ) -> FloatArray:
        normal = np.deg2rad(angle_deg + turn + 90)
        distance = x * np.cos(normal) + y * np.sin(normal) - offset
        return np.asarray(one + step * ndtr(distance / max(sigma, _SMALLEST_SIGMA_PX)))

    smooth = uniform_filter(image, _SMOOTHING_PX).ravel()
    noise = np.array([task.noise_dn(level) for level in smooth])
    start_normal = np.deg2rad(angle_deg + 90)
    distance = x * np.cos(start_normal) + y * np.sin(start_normal)
    far = np.quantile(distance, (0.2, 0.8))
    before, after = (
        float(np.median(image.ravel()[side])) for side in (distance < far[0], distance > far[1])
    )
    start = (before, after - before, 0.0, 0.0, 1.0)
    try:
        found, covariance = curve_fit(modelled, y, image.ravel(), start, np.maximum(noise, 1e-3))
    except (RuntimeError, OptimizeWarning) as error:
        raise PeerError(f"the fit does not converge: {error}") from error
    sigma = float(max(found[4], _SMALLEST_SIGMA_PX))
    return GaussianEdge(sigma_px=sigma, sigma_err_px=float(np.sqrt(covariance[4, 4])))


def chart_width_px(task: Task) -> float:
    """Median width of the Gaussian edges on a task's chart, as users of simple blurs measure it."""
    chart, found = task.linear("chart"), []
    for edge in task.facts["chart_edges"]:
        try:
            fit = fit_gaussian_edge(_cut(chart, edge["roi_px"]), edge["angle_deg"], task)
        except PeerError:
            continue
        found.append(fit.sigma_px)
    if not found:
        raise PeerError("no edge of the chart can be fitted")
    return float(np.median(found))


def _cut(image: FloatArray, roi_px: list[int]) -> FloatArray:
    left, top, right, bottom = roi_px
    return image[max(top, 0) : bottom, max(left, 0) : right]


def _by_edge(
    task: Task, measure: Callable[[FloatArray, float], Callable[[str], EdgeContrast]]
) -> list[EdgeContrast]:
    """Measure every edge of a chart that can be measured."""
    if task.facts["kind"] != "edges":
        raise PeerError("it needs edges")
    image, answers = task.linear("file"), []
    for edge in task.facts["edges"]:
        try:
            answer = measure(_cut(image, edge["roi_px"]), edge["angle_deg"])(edge["edge"])
        except PeerError:
            continue
        answers.append(answer)
    return answers


PROGRAMS = (
    Program(
        name="quickmtf",
        given="quickMTF on the linear pixels of each region, four bins a pixel",
        answers={"psf": lambda task: _by_edge(task, lambda image, _: quick_mtf(image).answer)},
        packages=("quickMTF",),
    ),
    Program(
        name="iso12233-bins",
        given="ISO 12233:2017, annex D, written out here: the linear pixels of each region, bins "
        "of 1/4 px about the edge line that standoff fits",
        answers={
            "psf": lambda task: _by_edge(
                task, lambda image, _: curve_by_bins(samples_of(image)[0]).answer
            )
        },
    ),
    Program(
        name="erf-fit",
        given="scipy's curve_fit of an edge behind a Gaussian: the linear pixels of each region, "
        "its angle and the noise",
        answers={
            "psf": lambda task: _by_edge(
                task, lambda image, angle: fit_gaussian_edge(image, angle, task).answer
            )
        },
        packages=("scipy",),
    ),
)
