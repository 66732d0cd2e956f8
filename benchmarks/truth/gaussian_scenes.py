"""Scenes whose detectability is known in closed form: Gaussian random fields, Gaussian lenses.

The covariance of a scene is a sum of Gaussians, so that of any two photographs of it is one too:
blurs add to the variances. Nothing here is shared with the code that is judged.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray as Array

N_PX = 33
REFERENCE_ZOOM = 2.0
SPOT_SIGMA_PX = 2.0
WAVES = 1500


@dataclass(frozen=True, kw_only=True)
class GaussianScene:
    """Variances and squared correlation lengths in px of the near photograph, without any blur."""

    variances_dn2: tuple[float, ...] = (300.0, 500.0, 900.0)
    lengths_px2: tuple[float, ...] = (0.8, 8.0, 80.0)

    def blurred(self, blur_px2: float) -> list[tuple[float, float]]:
        """Variance and squared length of each part after blurs of this sum of variances."""
        return [
            (variance * length / (length + blur_px2), length + blur_px2)
            for variance, length in zip(self.variances_dn2, self.lengths_px2, strict=True)
        ]

    def photograph(self, side_px: int, psf_px2: float, rng: np.random.Generator) -> Array:
        """One photograph through a lens of this variance, around 128 DN, without noise."""
        size = 2 * side_px
        at = np.minimum(np.arange(size), size - np.arange(size)).astype(float)
        covariance = np.zeros((size, size))
        for variance, length in self.blurred(2 * psf_px2):
            line = np.exp(-0.5 * at**2 / length)
            covariance += variance * np.outer(line, line)
        power = np.maximum(np.fft.fft2(covariance).real, 0.0)
        noise = rng.standard_normal((size, size)) + 1j * rng.standard_normal((size, size))
        drawn = np.fft.ifft2(np.sqrt(power) * noise) * size
        return np.asarray(128.0 + drawn.real[:side_px, :side_px])

    def waves(self, rng: np.random.Generator) -> "_Waves":
        """One scene of this kind, as a sum of plane waves."""
        lengths = np.repeat(self.lengths_px2, WAVES)
        amplitude = np.repeat(np.sqrt(np.array(self.variances_dn2) / WAVES), WAVES)
        parts = rng.standard_normal((2, lengths.size))
        return _Waves(
            vectors=rng.standard_normal((lengths.size, 2)) / np.sqrt(lengths)[:, None],
            amplitudes=amplitude * (parts[0] + 1j * parts[1]),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Waves:
    """A scene that can be photographed more than once: wave vectors, shape (n, 2), per near px."""

    vectors: Array
    amplitudes: NDArray[np.complex128]

    def photograph(self, side_px: int, zoom: float, psf_px2: float) -> Array:
        """Photograph around 128 DN from ``zoom`` times as far, through a lens of this variance."""
        at = zoom * (np.arange(side_px) - (side_px - 1) / 2)
        left = np.exp(-0.5 * zoom**2 * psf_px2 * np.sum(self.vectors**2, axis=1))
        down = np.exp(1j * np.outer(at, self.vectors[:, 0]))
        across = np.exp(1j * np.outer(self.vectors[:, 1], at))
        return np.asarray(128.0 + ((down * (left * self.amplitudes)) @ across).real)


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """A window on the reference, the follow-up's pixels around it, and their own two lenses.

    ``phase`` is where the window's middle lies between follow-up pixels, ``(y, x)``.
    """

    zoom: float
    psf_px2: float
    phase: tuple[float, float]
    reference_px2: float = 0.0
    followup_px2: float = 0.0

    @property
    def _axes(self) -> list[tuple[Array, Array, Array]]:
        """For each axis: places of reference and of follow-up pixels in near px, and U."""
        axes = []
        for phase in self.phase:
            near = REFERENCE_ZOOM * (np.arange(N_PX) - N_PX // 2)
            step = REFERENCE_ZOOM * self.zoom
            count = int(N_PX / self.zoom / 2) + 4
            index = np.arange(-count, count + 1)
            far = np.asarray(step * (index + phase))
            axes.append((np.asarray(near), far, _keys(np.asarray(near / step - phase), index)))
        return axes

    def signal(self) -> Array:
        """What is left of the spot on the reference's pixels; it lies in the window's middle."""
        lens_px2 = (REFERENCE_ZOOM * self.zoom) ** 2 * (self.psf_px2 + self.followup_px2)
        total = SPOT_SIGMA_PX**2 - self.psf_px2 + lens_px2
        lines = [up @ np.exp(-0.5 * far**2 / total) for _, far, up in self._axes]
        return np.asarray(SPOT_SIGMA_PX**2 / total * np.outer(*lines))

    def artefact(self, scene: GaussianScene) -> list[tuple[float, Array, Array]]:
        """Covariance of the difference without noise: weights of Kronecker products (y, x)."""
        near_px2 = REFERENCE_ZOOM**2 * (self.psf_px2 + self.reference_px2)
        far_px2 = (REFERENCE_ZOOM * self.zoom) ** 2 * (self.psf_px2 + self.followup_px2)
        parts = []
        for blur, kind in ((2 * far_px2, "ff"), (near_px2 + far_px2, "nf"), (2 * near_px2, "nn")):
            for variance, length in scene.blurred(blur):
                products = []
                for near, far, up in self._axes:
                    if kind == "ff":
                        products.append(up @ _gauss(far, far, length) @ up.T)
                    elif kind == "nn":
                        products.append(_gauss(near, near, length))
                    else:
                        products.append(up @ _gauss(far, near, length))
                sign = -1.0 if kind == "nf" else 1.0
                parts.append((sign * variance, products[0], products[1]))
                if kind == "nf":
                    parts.append((sign * variance, products[0].T, products[1].T))
        return parts

    def noise(self) -> list[tuple[float, Array, Array]]:
        """Covariance of the difference of white noise of variance 1, likewise."""
        ups = [up @ up.T for _, _, up in self._axes]
        return [(1.0, np.eye(N_PX), np.eye(N_PX)), (1.0, ups[0], ups[1])]


PHASES = tuple((float(y), float(x)) for y, x in np.random.default_rng(1).uniform(-0.5, 0.5, (6, 2)))


@lru_cache(maxsize=256)
def _templates(scene: GaussianScene, psf_px2: float, zoom: float, noise_dn: float) -> list[Array]:
    """Hotelling's templates at each phase, for lenses in their mean focus.

    The artefact is that of any place: its covariance by lag, averaged over the phases.
    """
    pairs = [_Pair(zoom=zoom, psf_px2=psf_px2, phase=phase) for phase in PHASES]
    by_lag = _stationary(
        np.mean([_written(p.artefact(scene)) for p in _many(zoom, psf_px2)], axis=0)
    )
    found = []
    for pair in pairs:
        whole = noise_dn**2 * _written(pair.noise()) + by_lag
        weights = np.linalg.solve(whole, pair.signal().ravel())
        found.append(np.asarray(weights.reshape(N_PX, N_PX), np.float64))
    return found


def true_d_prime(
    scene: GaussianScene,
    psf_px2: float,
    zoom: float,
    noise_dn: float,
    contrast_dn: float,
    focus_px2: tuple[float, float] = (0.0, 0.0),
) -> float:
    """The d' of those templates where reference and follow-up have a focus of their own."""

    def focused(phase: tuple[float, float]) -> _Pair:
        return _Pair(
            zoom=zoom,
            psf_px2=psf_px2,
            phase=phase,
            reference_px2=focus_px2[0],
            followup_px2=focus_px2[1],
        )

    around = [focused(pair.phase).artefact(scene) for pair in _many(zoom, psf_px2)]
    values = []
    for template, phase in zip(_templates(scene, psf_px2, zoom, noise_dn), PHASES, strict=True):
        pair = focused(phase)
        spread = noise_dn**2 * _quadratic(template, pair.noise())
        spread += float(np.mean([_quadratic(template, parts) for parts in around]))
        values.append(contrast_dn * float(np.sum(template * pair.signal())) / np.sqrt(spread))
    return float(np.mean(values))


def _many(zoom: float, psf_px2: float) -> list[_Pair]:
    phases = (np.arange(4) + 0.5) / 4 - 0.5
    return [_Pair(zoom=zoom, psf_px2=psf_px2, phase=(y, x)) for y in phases for x in phases]


def _quadratic(template: Array, parts: list[tuple[float, Array, Array]]) -> float:
    return sum(w * float(np.sum(template * (y @ template @ x.T))) for w, y, x in parts)


def _written(parts: list[tuple[float, Array, Array]]) -> Array:
    return np.asarray(sum(weight * np.kron(y, x) for weight, y, x in parts))


def _stationary(covariance: Array) -> Array:
    """Mean over all pairs of pixels of one lag."""
    n = N_PX
    four = covariance.reshape(n, n, n, n)
    y, x = np.indices((n, n))
    lag_y = y[:, :, None, None] - y[None, None]
    lag_x = x[:, :, None, None] - x[None, None]
    code = (lag_y + n) * 2 * n + lag_x + n
    sums = np.bincount(code.ravel(), four.ravel(), minlength=4 * n * n)
    counts = np.bincount(code.ravel(), minlength=4 * n * n)
    return np.asarray((sums / np.maximum(counts, 1))[code].reshape(n * n, n * n))


def _gauss(first: Array, second: Array, length_px2: float) -> Array:
    return np.asarray(np.exp(-0.5 * (first[:, None] - second[None]) ** 2 / length_px2))


def _keys(places: Array, index: NDArray[np.integer]) -> Array:
    """Weights of Keys' cubic, a = -1/2, of the samples at whole numbers ``index``."""
    t = np.abs(places[:, None] - index[None])
    inner = 1.5 * t**3 - 2.5 * t**2 + 1
    outer = -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    return np.where(t < 1, inner, np.where(t < 2, outer, 0.0))
