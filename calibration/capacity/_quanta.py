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
from dataclasses import dataclass, field
from math import ceil, inf, pi, sqrt
from typing import Final, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoisePower:
    """Noise power of an image in DN^2 px^2, or per px^2 of frequency: white, or a radial spectrum.

    ``variance_dn2`` is the variance of a pixel, ``relative_err`` the standard error of its root.
    ``freq_cy_per_px`` and ``shape`` are the spectrum over that of white noise, which has mean 1
    over all frequencies; without them the noise is white.
    """

    variance_dn2: float
    relative_err: float = 0.0
    freq_cy_per_px: tuple[float, ...] = field(default=(), repr=False)
    shape: tuple[float, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.variance_dn2 < inf:
            raise ValueError(f"variance_dn2 must be positive, got {self.variance_dn2}")
        if len(self.freq_cy_per_px) != len(self.shape):
            raise ValueError(
                f"a noise spectrum of {len(self.freq_cy_per_px)} frequencies has "
                f"{len(self.shape)} values"
            )
        if self.shape and not min(self.shape) > 0:
            raise ValueError("a noise spectrum must be positive everywhere")

    @property
    def is_white(self) -> bool:
        """Whether the noise of neighbouring pixels is independent."""
        return not self.shape

    def at(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Return the noise power at frequencies; beyond Nyquist it repeats."""
        fx, fy = np.broadcast_arrays(fx, fy)
        if self.is_white:
            return np.full(fx.shape, self.variance_dn2)
        folded = np.hypot(fx - np.round(fx), fy - np.round(fy))
        return np.asarray(self.variance_dn2 * np.interp(folded, self.freq_cy_per_px, self.shape))


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
        return np.asarray(signal**2 / self.noise.at(fx, fy))

    def neq_err(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Return the standard error of `neq`, from the noise and, if known, from the transfer."""
        value = self.neq(fx, fy)
        by_noise = 2 * self.noise.relative_err * value
        if self.transfer_err is None:
            return by_noise
        slope = 2 * self.signal_dn**2 * np.abs(self.transfer(fx, fy)) / self.noise.at(fx, fy)
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


def noise_power_spectrum(frames_dn: ArrayLike, block_px: int = 64) -> NoisePower:
    """Measure the noise power of several frames of one evenly lit surface.

    The mean of the frames is taken off, and with it all that stands still: fixed pattern, shading
    and dust. What is left is cut into overlapping blocks, windowed (Hann) and transformed; the
    spectrum is averaged over blocks and frames and over rings of frequency. It is for use from
    Python: ``standoff lens`` takes noise as white.

    Parameters
    ----------
    frames_dn
        Linear levels, shape ``(frames, rows, cols)``; two frames at least.
    block_px
        Side of the blocks.

    Returns
    -------
    NoisePower
        Of one frame, with the variance in DN^2 and the spectrum by frequency to its corner at
        0.71 cy/px.

    Raises
    ------
    ValueError
        If there are fewer than two frames, or they are smaller than a block or do not differ.
    """
    frames = np.asarray(frames_dn, dtype=np.float64)
    if frames.ndim != 3 or frames.shape[0] < 2:
        raise ValueError(f"two frames at least are needed, got shape {frames.shape}")
    if min(frames.shape[1:]) < block_px:
        raise ValueError(f"frames of {frames.shape[1:]} are smaller than a block of {block_px} px")
    left = (frames - frames.mean(axis=0)) * sqrt(frames.shape[0] / (frames.shape[0] - 1))
    variance = float(np.mean(left**2))
    if variance == 0:
        raise ValueError("the frames do not differ: there is no noise to measure")
    power = _block_power(left, block_px)
    freq = np.fft.fftfreq(block_px)
    radius = np.hypot(freq[:, None], freq[None, :])
    rings = np.round(radius * block_px).astype(np.int64)
    count = np.bincount(rings.ravel())
    mean = np.bincount(rings.ravel(), power.ravel()) / count
    place = np.bincount(rings.ravel(), radius.ravel()) / count
    used = np.arange(count.size) > 1  # the window spreads the mean, which was taken off, that far
    scale = float(power.mean())
    independent = left.size * (frames.shape[0] - 1) / frames.shape[0]
    spread = float(np.sqrt(np.mean((power / scale) ** 2)))
    return NoisePower(
        variance_dn2=variance,
        relative_err=spread / sqrt(2 * independent),
        freq_cy_per_px=tuple(place[used].tolist()),
        shape=tuple((mean[used] / scale).tolist()),
    )


def _block_power(images: FloatArray, block_px: int) -> FloatArray:
    """Mean power spectrum of windowed blocks, half a block apart, shape (block, block)."""
    rows, cols = images.shape[1:]
    window = np.hanning(block_px + 1)[:-1]
    window = np.outer(window, window)
    step, total, count = block_px // 2, np.zeros((block_px, block_px)), 0
    for top in range(0, rows - block_px + 1, step):
        for first in range(0, cols - block_px + 1, step):
            block = images[:, top : top + block_px, first : first + block_px] * window
            total += np.sum(np.abs(np.fft.fft2(block)) ** 2, axis=0)
            count += images.shape[0]
    return np.asarray(total / (count * np.sum(window**2)))


def _refuse_size(name: str, value: float) -> None:
    if not 0 < value < inf:
        raise ValueError(f"{name} must be positive, got {value}")
