"""Noise-equivalent quanta, and what an ideal observer sees with them.

``NEQ(f) = S^2 H(f)^2 / N(f)``, with the signal S, the transfer H of lens and pixel and the noise
power N: an image of that many quanta a pixel by a detector without blur or other noise would show a
pattern of the frequency f as well. An ideal observer detects an object of contrast C and spectrum
``T`` (the Fourier transform of its shape) with ``SNR^2 = C^2 integral |T|^2 NEQ``.

The integral goes over the whole plane, with the noise power repeated beyond Nyquist, as that of a
sampled image is: it is the mean of SNR^2 over all places of the object on the pixel grid.

References
----------
ICRU Report 54, "Medical imaging: the assessment of image quality", 1996, sections 3 and 4. Barrett
and Myers, "Foundations of image science", Wiley, 2004, section 13.2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf, pi, sqrt
from typing import Final, Protocol, TypeAlias

import numpy as np
from scipy.special import j1

from simulation.arrays import FloatArray

Transfer: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]
"""Transfer of lens and pixel, 1 at 0, at frequencies along x and y in cy/px; the two broadcast."""

_FARTHEST_CY_PER_PX = 1.5  # beyond, the square pixel alone has passed its first zero
_PANEL_CY_PER_PX = 0.25
_NODES = 6  # of Gauss and Legendre in each panel
ROSE_SNR: Final = 5.0
"""The SNR at which an object is seen nearly surely: A. Rose, "The sensitivity performance of the
human eye on an absolute scale", J. Opt. Soc. Am. 38, 1948, 196."""
_SAME = 1e-12


class DetectionTarget(Protocol):
    """An object to detect, of contrast 1, in px."""

    @property
    def extent_px(self) -> float:
        """Its largest size, which says how finely its spectrum has to be sampled."""
        ...

    def spectrum(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Fourier transform about its centre, px^2, at frequencies in cy/px."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Disc:
    """A disc with a sharp rim."""

    diameter_px: float

    def __post_init__(self) -> None:
        _refuse_size("diameter_px", self.diameter_px)

    @property
    def extent_px(self) -> float:
        """Its diameter."""
        return self.diameter_px

    def spectrum(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Airy's pattern: ``R J1(2 pi R f) / f``."""
        radius, freq = 0.5 * self.diameter_px, np.hypot(fx, fy)
        beyond = np.maximum(freq, _SAME)
        wave = radius * j1(2 * pi * radius * beyond) / beyond
        return np.where(freq > _SAME, wave, pi * radius**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """An upright bar of a width along x and a length along y."""

    width_px: float
    length_px: float

    def __post_init__(self) -> None:
        _refuse_size("width_px", self.width_px)
        _refuse_size("length_px", self.length_px)

    @property
    def extent_px(self) -> float:
        """Its length or its width, whichever is larger."""
        return max(self.width_px, self.length_px)

    def spectrum(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Product of two sinc functions."""
        along_x = self.width_px * np.sinc(self.width_px * fx)
        return np.asarray(along_x * self.length_px * np.sinc(self.length_px * fy))


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianSpot:
    """A Gaussian spot of peak 1."""

    sigma_px: float

    def __post_init__(self) -> None:
        _refuse_size("sigma_px", self.sigma_px)

    @property
    def extent_px(self) -> float:
        """Where it has fallen to a hundredth, on either side."""
        return 6.0 * self.sigma_px

    def spectrum(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """A Gaussian."""
        variance = self.sigma_px**2
        return np.asarray(2 * pi * variance * np.exp(-2 * pi**2 * variance * (fx**2 + fy**2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisePower:
    """White noise of an image: its power, in DN^2 px^2, is the variance of a pixel everywhere.

    ``relative_err`` is the standard error of the variance's root.
    """

    variance_dn2: float
    relative_err: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.variance_dn2 < inf:
            raise ValueError(f"variance_dn2 must be positive, got {self.variance_dn2}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalAndNoise:
    """A camera at one level of light.

    ``transfer`` of lens and pixel, ``noise`` of one image, ``signal_dn``: the level above black.
    ``transfer_err`` gives the standard error of the transfer, if that is known.
    """

    transfer: Transfer
    noise: NoisePower
    signal_dn: float
    transfer_err: Transfer | None = None

    def __post_init__(self) -> None:
        if not 0 < self.signal_dn < inf:
            raise ValueError(f"signal_dn must be positive, got {self.signal_dn}")

    def neq(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Noise-equivalent quanta per px at frequencies in cy/px; the two broadcast."""
        signal = self.signal_dn * np.asarray(self.transfer(fx, fy))
        return np.asarray(signal**2 / self.noise.variance_dn2)

    def neq_err(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Return the standard error of `neq`, from the noise and, if known, from the transfer."""
        value = self.neq(fx, fy)
        by_noise = 2 * self.noise.relative_err * value
        if self.transfer_err is None:
            return by_noise
        slope = 2 * self.signal_dn**2 * np.abs(self.transfer(fx, fy)) / self.noise.variance_dn2
        return np.asarray(np.hypot(by_noise, slope * self.transfer_err(fx, fy)))

    def sharper_by_err(self) -> "SignalAndNoise | None":
        """Return the camera with its transfer one standard error higher; None if unknown."""
        if self.transfer_err is None:
            return None
        transfer, err = self.transfer, self.transfer_err

        def higher(fx: FloatArray, fy: FloatArray) -> FloatArray:
            known = np.asarray(transfer(fx, fy))
            return np.asarray(known + np.where(known < 0, -1.0, 1.0) * err(fx, fy))

        return SignalAndNoise(transfer=higher, noise=self.noise, signal_dn=self.signal_dn)


def ideal_observer_snr(
    camera: SignalAndNoise, target: DetectionTarget, contrast: float = 1.0
) -> float:
    """Return the SNR with which an ideal observer detects an object in one image.

    Parameters
    ----------
    camera
        Transfer, noise and level of light.
    target
        The object, which the observer knows exactly.
    contrast
        Its difference from the light around it, over that light.

    Returns
    -------
    float
        d', the root of the mean of SNR^2 over the places of the object on the pixel grid.
    """
    fx, fy, weight = _half_plane(target.extent_px)
    energy = target.spectrum(fx, fy) ** 2 * camera.neq(fx, fy)
    return abs(contrast) * sqrt(2.0 * float(np.sum(weight * energy)))


def edge_shift_snr(
    camera: SignalAndNoise, contrast: float, length_px: float, shift_px: float = 1.0
) -> float:
    """Return the SNR with which an ideal observer sees that a straight edge has moved.

    The edge is as long as ``length_px``, and moves across itself by ``shift_px``; the value is the
    mean square over the directions of the edge. ``contrast`` is its step over the level of light.
    """
    along = _mean_neq_of_edges(camera, shift_px)
    freq, weight = _half_line(abs(shift_px))
    moved = shift_px * np.sinc(shift_px * freq)
    return abs(contrast) * sqrt(2.0 * length_px * float(np.sum(weight * moved**2 * along)))


def edge_location_err_px(camera: SignalAndNoise, contrast: float, length_px: float) -> float:
    """Return the least standard error with which a straight edge can be located (Cramer and Rao).

    The edge and its blur are known but for where it lies across itself; mean square of the inverse
    over its directions.
    """
    along = _mean_neq_of_edges(camera, 0.0)
    _, weight = _half_line(0.0)
    return 1.0 / (abs(contrast) * sqrt(2.0 * length_px * float(np.sum(weight * along))))


_DIRECTIONS = 24


def _mean_neq_of_edges(camera: SignalAndNoise, extent_px: float) -> FloatArray:
    """NEQ along the normals of edges, averaged over directions, on the nodes of `_half_line`."""
    freq, _ = _half_line(abs(extent_px))
    turn = (np.arange(_DIRECTIONS) + 0.5) * pi / _DIRECTIONS
    return np.asarray(
        camera.neq(np.outer(np.cos(turn), freq), np.outer(np.sin(turn), freq)).mean(axis=0)
    )


def _half_line(extent_px: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies above 0 and their weights, for objects of a size."""
    width = min(_PANEL_CY_PER_PX, 1.0 / max(extent_px, _SAME))
    panels = ceil(_FARTHEST_CY_PER_PX / width)
    edges = np.linspace(0.0, _FARTHEST_CY_PER_PX, panels + 1)
    node, share = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (edges[1:] - edges[:-1])[:, None]
    freq = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * node
    return freq.ravel(), (half * share).ravel()


def _half_plane(extent_px: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies with fy above 0 along both axes and their weights; the three broadcast."""
    freq, weight = _half_line(extent_px)
    both = np.concatenate([-freq[::-1], freq])
    weights = np.concatenate([weight[::-1], weight])
    return both[None, :], freq[:, None], weight[:, None] * weights


def _refuse_size(name: str, value: float) -> None:
    if not 0 < value < inf:
        raise ValueError(f"{name} must be positive, got {value}")
