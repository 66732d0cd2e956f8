"""The standard error of a simulated follow-up at each pixel, and where it comes from.

**PSF.** The parameters of a PSF are correlated, and most of their combinations hardly change what a
camera further away sees. With ``J`` the derivative of ``H(z f) / H(f)``, weighted by what an
average scene has at each frequency, and ``C = L L^T`` the covariance of the parameters, the
singular vectors ``v`` of ``J L`` are the directions that matter, and ``L v`` steps of one standard
error that are independent of each other.

**Focus.** A PSF whose covariance grows by ``D`` turns a level I into ``I + (D : grad grad I) / 2``,
to first order. The derivatives are those of the cosine series through the pixels, mirrored at the
edges, so that they are exact for every frequency that the pixels hold.

**Model.** A reference holds frequencies up to its pixels' limit, and folds those beyond onto them.
For scenes of the covariance that ``docs/theory-lmmse.md`` assumes, with ``S`` its spectrum, ``D``
what two reference pixels share, ``H1`` and ``H2`` the transfer functions near and far (the latter
in the reference's frequencies) and ``K`` that of the model, the error is, over all subpixel
positions,

    integral of S H2^2 - 2 K S H1 H2 + K^2 D

How strong a scene is at a place is told by the squared steps between its pixels there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import isfinite

import numpy as np
from scipy.fft import dct, idct, idst
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter, map_coordinates

from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.capture_noise import propagated_variance
from simulation.choices import POSE_MODELS, Model
from simulation.pose import (
    LocalPose,
    PoseOptions,
    PoseView,
    derivatives,
    pose_noise_gain,
    poses_at_followup,
    simulate_pose_of_image,
)
from simulation.psf import GaussianPsf, Psf, PsfField
from simulation.sampling_grid import SamplingGrid
from simulation.seen_scene import SCENE_CORRELATION_PX, SeenScene
from simulation.zoom import zoom_operator, zoom_out_on_grid

_UNIT = GaussianPsf(1.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedView:
    """What a follow-up sees of a reference ``(rows, cols)``, and the model that simulates it.

    ``matrix`` takes follow-up to reference pixels, ``size`` is ``(width, height)`` of the
    follow-up, the model ``matched``, ``lmmse`` or ``paper``. ``grid`` is that of a follow-up that
    is merely further away; None for another pose. ``options`` hold threads, distortion and the
    follow-up's place in the camera's frame.
    """

    reference: tuple[int, int]
    matrix: FloatArray
    size: tuple[int, int]
    model: Model
    grid: SamplingGrid | None
    options: PoseOptions

    @classmethod
    def at_zoom(
        cls, reference: tuple[int, int], zoom: float, model: Model, threads: int = 1
    ) -> "SimulatedView":
        """View from ``zoom`` times further away."""
        grid = SamplingGrid.centred(reference, zoom)
        origin_px = (reference[1] - grid.cols) / 2, (reference[0] - grid.rows) / 2
        return cls(
            reference=reference,
            matrix=grid.matrix,
            size=(grid.cols, grid.rows),
            model=model,
            grid=grid,
            options=_of_model(PoseOptions(threads=threads, origin_px=origin_px), model),
        )

    @classmethod
    def of_pose(
        cls,
        reference: tuple[int, int],
        matrix: FloatArray,
        size: tuple[int, int],
        options: PoseOptions,
    ) -> "SimulatedView":
        """View from another pose."""
        return cls(
            reference=reference,
            matrix=matrix,
            size=size,
            model=options.model,
            grid=None,
            options=options,
        )

    @property
    def zoom(self) -> float:
        """Zoom in the middle of the follow-up."""
        x, y = (self.size[0] - 1) // 2, (self.size[1] - 1) // 2
        xx, xy, yy = self._survey(np.array([float(y)]), np.array([float(x)]))[0, 0, 2:]
        return float((xx * yy - xy * xy) ** 0.25)

    def rendered(self, image: AnyArray, psf: Psf | PsfField) -> FloatArray:
        """Follow-up of an image of the reference's size, in double precision."""
        exact = np.asarray(image, dtype=np.float64)
        if self.grid is not None and not isinstance(psf, PsfField):
            threads = self.options.threads
            seen = zoom_out_on_grid(exact, self.grid, psf, self.model, threads=threads)
        else:
            seen = simulate_pose_of_image(exact, self.matrix, self.size, psf, self.options).image
        return np.asarray(seen, dtype=np.float64)

    def noise_variance(self, variance_dn2: FloatArray, psf: Psf | PsfField) -> FloatArray:
        """Variance left of independent noise in the reference, of the follow-up's shape.

        ``variance_dn2`` is that of each reference pixel, shape ``(rows, cols)`` or ``(rows, cols,
        channels)``. Exact further away. For another pose the sum of the squared weights is
        multiplied by the variance as the follow-up sees it, which is right where it hardly changes
        within a kernel.
        """
        if self.grid is None or isinstance(psf, PsfField):
            gain = pose_noise_gain(self.matrix, self.reference, self.size, psf, self.options)
            seen = np.maximum(self.rendered(variance_dn2, psf), 0.0)
            return np.asarray(seen * (gain if seen.ndim == 2 else gain[:, :, None]))
        operator = zoom_operator(self.reference, self.grid, psf, self.model)
        if variance_dn2.ndim == 2:
            return propagated_variance(operator, variance_dn2)
        planes = np.moveaxis(variance_dn2, 2, 0)
        return np.stack([propagated_variance(operator, plane) for plane in planes], axis=-1)

    def survey(self) -> FloatArray:
        """Place x, y of each pixel and ``A A^T`` of the warp, shape ``(height, width, 5)``."""
        return self._survey(np.arange(float(self.size[1])), np.arange(float(self.size[0])))

    def pose_view(self, psf: Psf | PsfField) -> PoseView:
        """The view with a PSF, for what varies over it."""
        return PoseView.of(
            self.matrix,
            self.reference,
            self.size,
            psf,
            self.options.origin_px,
            self.options.distortion_k1,
        )

    def _survey(self, rows_px: FloatArray, cols_px: FloatArray) -> FloatArray:
        # Of a PSF of unit width the missing blur is A A^T less the unit matrix.
        seen = self.pose_view(_UNIT).survey(rows_px, cols_px)
        return np.asarray(seen + np.array([0, 0, 1.0, 0, 1.0]))


def _of_model(options: PoseOptions, model: Model) -> PoseOptions:
    known = [name for name in POSE_MODELS if name == model]
    return replace(options, model=known[0]) if known else options


_KEPT = 0.999
"""Part of the variance of an average scene's response that the steps kept explain."""

_LEAST_RESPONSE = 2e-3
"""Of the scene's standard deviation: kernels are cut off where they matter less than a tenth of
it, and a smaller step would measure where they end."""

_LONGEST = 64.0
_SHORTEST = 1 / 16
_NEAR_ZERO = 3e-3  # as the kernels of model matched
_SLOPE_STEP = 0.1
_FREQUENCIES = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfStep:
    """Two PSFs on either side of the calibrated one, which is one of them where a side is no PSF.

    ``length`` are the standard errors from ``minus`` to ``plus``: the difference of two images over
    it is the change by one standard error.
    """

    plus: Psf | PsfField
    minus: Psf | PsfField
    length: float


def principal_steps(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, covariance: FloatArray, zoom: float
) -> tuple[PsfStep, ...]:
    """The independent steps of one standard error that matter to a follow-up.

    ``psf_of`` gives the PSF of parameters, with a ValueError where there is none; ``covariance`` is
    that of the errors of the ``values``. The zoom need only be about right. The steps' responses
    explain 99.9 % of the variance of an average scene's; none if the covariance is zero.
    """
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    columns = [_slope(psf_of, values, root[:, k], zoom) for k in range(len(values))]
    _, strength, turned = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
    total = float(np.sum(strength**2))
    if not total > 0:
        return ()
    missing = 1 - np.cumsum(strength**2) / total
    count = int(np.argmax(missing <= 1 - _KEPT)) + 1
    lengths = np.clip(_LEAST_RESPONSE / strength[:count], 1.0, _LONGEST).tolist()
    return tuple(
        _sides(psf_of, values, root @ turned[k], length) for k, length in enumerate(lengths)
    )


def _slope(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, step: FloatArray, zoom: float
) -> FloatArray:
    """Change of a scene's image by a step, weighted by frequency, shape ``(n,)``."""
    if not np.any(step):
        return np.zeros(_response(psf_of(values), zoom).size)
    sides = _sides(psf_of, values, step, _SLOPE_STEP)
    return (_response(sides.plus, zoom) - _response(sides.minus, zoom)) / sides.length


def _response(psf: Psf | PsfField, zoom: float) -> FloatArray:
    """``H(z f) H(f) / (H(f)^2 + e^2) H(f)`` over the pixels' band, times an average scene."""
    assert not isinstance(psf, PsfField)
    steps = np.arange(-_FREQUENCIES, _FREQUENCIES + 1) / (2 * _FREQUENCIES)
    fy, fx = steps[_FREQUENCIES:, None], steps[None, :]
    near, far = psf.otf(fx, fy), psf.otf(zoom * fx, zoom * fy)
    radius2 = (2 * np.pi * SCENE_CORRELATION_PX) ** 2 * (fx**2 + fy**2)
    power = 2 * np.pi * SCENE_CORRELATION_PX**2 / (1 + radius2) ** 1.5
    # Each frequency of this half plane stands for its opposite, too.
    weight = np.sqrt(2 * power) / (2 * _FREQUENCIES)
    return np.asarray(far * near**2 / (near**2 + _NEAR_ZERO**2) * weight).ravel()


def _sides(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, step: FloatArray, length: float
) -> PsfStep:
    """The PSFs on either side, or on one, as far away as asked for or as there are any."""
    while length >= _SHORTEST * _SLOPE_STEP:
        plus, minus = (_psf(psf_of, values + sign * length * step) for sign in (1.0, -1.0))
        if plus is not None and minus is not None:
            return PsfStep(plus=plus, minus=minus, length=2 * length)
        if plus is not None:
            return PsfStep(plus=plus, minus=psf_of(values), length=length)
        if minus is not None:
            return PsfStep(plus=psf_of(values), minus=minus, length=length)
        length /= 2
    raise ValueError("the PSF's parameters have no neighbours that are a PSF")


def _psf(psf_of: Callable[[FloatArray], Psf], values: FloatArray) -> Psf | None:
    try:
        with np.errstate(invalid="ignore"):  # a root of a negative value is refused as no number
            return psf_of(values)
    except ValueError:
        return None


def _second_derivatives(image: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives xx, xy and yy per px^2, each of the shape of ``image``."""
    return (
        _twice(image, 1),
        _once(_once(image, 1), 0),
        _twice(image, 0),
    )


def _orders(image: FloatArray, axis: int) -> FloatArray:
    count = image.shape[axis]
    shape = [1] * image.ndim
    shape[axis] = count
    return np.asarray(np.pi * np.arange(count) / count).reshape(shape)


def _twice(image: FloatArray, axis: int) -> FloatArray:
    waves = dct(image, axis=axis, norm="ortho")
    return np.asarray(idct(-(_orders(image, axis) ** 2) * waves, axis=axis, norm="ortho"))


def _once(image: FloatArray, axis: int) -> FloatArray:
    """First derivative; of a series of cosines, it is one of sines."""
    waves = -_orders(image, axis) * dct(image, axis=axis, norm="ortho")
    # Sine number k of the inverse is the wave number k + 1, and the last one is none of these.
    waves = np.roll(waves, -1, axis=axis)
    last = [slice(None)] * image.ndim
    last[axis] = slice(-1, None)
    waves[tuple(last)] = 0.0
    return np.asarray(idst(waves, axis=axis, norm="ortho"))


_PERIOD_PX = 64
_RIDGE = 1e-6
_POINTS = 5
"""Positions per axis at which errors are computed; linear between."""

_WINDOW_ZOOMS = 2.0
"""Width of the window in which the scene's strength is measured, in follow-up pixels."""

_STATED: tuple[Model, ...] = ("matched", "lmmse")


def model_variance(
    view: SimulatedView, psf: Psf | PsfField, reference: FloatArray, noise_dn2: FloatArray | None
) -> FloatArray | None:
    """The model's expected squared error at each pixel of a follow-up, shape ``(height, width)``.

    None for a model that states no error. ``noise_dn2`` is the variance of the reference's noise,
    of its shape, which is no structure of the scene; None if it is not known.
    """
    if view.model not in _STATED:
        return None
    seen = view.survey()
    if view.pose_view(psf).is_by_whole_pixels:
        return np.zeros(seen.shape[:2])
    strength = _strength(reference, psf, view.zoom, noise_dn2)
    places = seen[..., 1], seen[..., 0]
    local = map_coordinates(strength, places, order=1, mode="nearest")
    return np.asarray(local * _error_over_followup(view, psf))


def _strength(
    reference: FloatArray, psf: Psf | PsfField, zoom: float, noise_dn2: FloatArray | None
) -> FloatArray:
    """Variance of a scene of the assumed covariance that has as large steps from pixel to pixel."""
    along_x = np.diff(reference, axis=1, append=reference[:, -1:]) ** 2
    along_y = np.diff(reference, axis=0, append=reference[-1:]) ** 2
    squares = 0.5 * (along_x + along_y)
    if noise_dn2 is not None:
        squares = squares - 2 * noise_dn2
    middle = psf.at(*psf.centre_px) if isinstance(psf, PsfField) else psf
    share = _assumed_scene(middle).covariance
    unit = 2 * share[0, 0] - share[0, 1] - share[1, 0]
    around = gaussian_filter(squares, _WINDOW_ZOOMS * max(zoom, 1.0), mode="reflect")
    return np.asarray(np.maximum(around, 0.0) / unit)


def _error_over_followup(view: SimulatedView, psf: Psf | PsfField) -> FloatArray:
    """Error in a scene of variance 1, shape ``(height, width)``."""
    pose = view.pose_view(psf)
    rows, cols = pose.follow_up
    y, x = (np.linspace(0.0, max(count - 1, 1), _POINTS) for count in (rows, cols))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    slopes = derivatives(pose.matrix, pose.lens, points)[1]
    errors = [
        _error_of_pose(local, tuple(np.round(true, 6).ravel().tolist()), view.model)
        for local, true in zip(poses_at_followup(pose, points), slopes, strict=True)
    ]
    between = RegularGridInterpolator((y, x), np.array(errors).reshape(_POINTS, _POINTS))
    at = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=-1)
    return np.asarray(between(at))


@lru_cache(maxsize=256)
def _error_of_pose(pose: LocalPose, slopes: tuple[float, ...], model: Model) -> float:
    """Error of a model made for a pose, where the camera looks along ``slopes``."""
    scene = _assumed_scene(pose.near)
    period = scene.period_px
    last = scene.power.shape[0] - 1
    steps = np.arange(-last, last + 1) / period
    fy, fx = steps[last:, None], steps[None, :]
    twice = np.where(fy > 0, 2.0, 1.0)
    known, true = (_seen(pose.far, a, fx, fy) for a in (pose.slopes, slopes))
    folded = np.fft.ifft2(scene.covariance).real
    rows = np.arange(last + 1) % period
    cols = np.arange(-last, last + 1) % period
    shared = folded[np.ix_(rows, cols)]
    if model == "lmmse":
        kernel = scene.power * scene.near * known / (shared + _RIDGE * scene.variance / period**2)
    else:
        inside = (np.abs(fx) <= 0.5) & (np.abs(fy) <= 0.5)
        near = scene.near
        kernel = np.where(inside, known * near / (near**2 + _NEAR_ZERO**2), 0.0)
    error = scene.power * true**2 - 2 * kernel * scene.power * scene.near * true
    return max(float(np.sum(twice * (error + kernel**2 * shared))), 0.0)


def _seen(far: Psf, slopes: tuple[float, ...], fx: FloatArray, fy: FloatArray) -> FloatArray:
    """Transfer of the camera far away at frequencies of the reference."""
    xu, xv, yu, yv = slopes
    return far.otf(xu * fx + yu * fy, xv * fx + yv * fy)


@lru_cache(maxsize=32)
def _assumed_scene(psf: Psf) -> SeenScene:
    return SeenScene.through(psf, _PERIOD_PX, SCENE_CORRELATION_PX)


SOURCES = ("noise", "psf", "focus", "model")
_ADDED = "added_noise"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownErrors:
    """What is known of the errors of a simulation's inputs; None for what is not.

    ``noise_dn2`` is the variance of the reference's noise in each pixel, of its shape, independent
    of each other; ``psf_steps`` are independent steps of one standard error of the PSF;
    ``focus_scatter_px2`` is the standard deviation, from capture to capture, of the PSF's variance
    along either axis.
    """

    noise_dn2: FloatArray | None = None
    psf_steps: Sequence[PsfStep] | None = None
    focus_scatter_px2: float | None = None

    def __post_init__(self) -> None:
        scatter = self.focus_scatter_px2
        if scatter is not None and not (scatter >= 0 and isfinite(scatter)):
            raise ValueError(f"focus_scatter_px2 must not be negative, got {scatter}")
        noise = self.noise_dn2
        if noise is not None and not (np.isfinite(noise).all() and np.all(noise >= 0)):
            raise ValueError("the variances of the noise must be finite and not negative")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelUncertainty:
    """Variance of each pixel of a simulated follow-up, by source; None for what is not known.

    ``focus`` is that of both photographs. ``model`` is the squared error that the model expects of
    itself, None for a model that states none: an average over scenes of one kind, and not the error
    of this one. Pixels ``outside`` show nothing of the reference: their errors are NaN.
    ``added_noise`` was added to the follow-up as the noise of a capture.
    """

    noise: FloatArray | None = field(repr=False)
    psf: FloatArray | None = field(repr=False)
    focus: FloatArray | None = field(repr=False)
    model: FloatArray | None = field(repr=False)
    outside: BoolArray | None = field(default=None, repr=False)
    added_noise: FloatArray | None = field(default=None, repr=False)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Sources that are not in it."""
        return tuple(name for name in SOURCES if getattr(self, name) is None)

    @property
    def err(self) -> FloatArray | None:
        """Standard error of each pixel by all sources known; None if there are none."""
        return self._err((*SOURCES, _ADDED))

    @property
    def err_without_model(self) -> FloatArray | None:
        """Standard error without the model's own stated error."""
        return self._err((*SOURCES[:-1], _ADDED))

    def median_err(self, source: str) -> float | None:
        """Median over the follow-up of the standard error by one source; None if not known."""
        err = self._err((source,))
        return None if err is None else float(np.nanmedian(err))

    def scaled(self, light: FloatArray | float) -> "PixelUncertainty":
        """Return that of the follow-up with ``light`` times the light."""
        square = np.asarray(light) ** 2
        known = {name: getattr(self, name) for name in (*SOURCES, _ADDED)}
        return PixelUncertainty(
            **{name: None if one is None else one * square for name, one in known.items()},
            outside=self.outside,
        )

    def _err(self, sources: Sequence[str]) -> FloatArray | None:
        known = [one for one in (getattr(self, name) for name in sources) if one is not None]
        if not known:
            return None
        err = np.sqrt(np.sum(known, axis=0))
        if self.outside is not None:
            err[self.outside] = np.nan
        return np.asarray(err)


def pixel_uncertainty(
    view: SimulatedView,
    reference: AnyArray,
    psf: Psf | PsfField,
    errors: KnownErrors,
    outside: BoolArray | None = None,
) -> PixelUncertainty:
    """Propagate the errors of a simulation's inputs to each pixel of it but those ``outside``."""
    exact = np.asarray(reference, dtype=np.float64)
    noise = errors.noise_dn2
    return PixelUncertainty(
        noise=None if noise is None else view.noise_variance(noise, psf),
        psf=None if errors.psf_steps is None else _psf_variance(view, exact, errors.psf_steps),
        focus=_focus_variance(view, exact, psf, errors.focus_scatter_px2),
        model=_model_variance(view, exact, psf, noise),
        outside=outside,
    )


def _psf_variance(
    view: SimulatedView, reference: FloatArray, steps: Sequence[PsfStep]
) -> FloatArray:
    variance = np.zeros((view.size[1], view.size[0], *reference.shape[2:]))
    for step in steps:
        change = view.rendered(reference, step.plus) - view.rendered(reference, step.minus)
        variance += (change / step.length) ** 2
    return variance


def _focus_variance(
    view: SimulatedView,
    reference: FloatArray,
    psf: Psf | PsfField,
    scatter_px2: float | None,
) -> FloatArray | None:
    """Variance by the focus of the reference and, independent of it, of the follow-up."""
    if scatter_px2 is None:
        return None
    xx, xy, yy = (view.rendered(part, psf) for part in _second_derivatives(reference))
    stretch = view.survey()[..., 2:]
    if reference.ndim == 3:
        stretch = stretch[:, :, None, :]
    far = stretch[..., 0] * xx + 2 * stretch[..., 1] * xy + stretch[..., 2] * yy
    near = xx + yy
    return np.asarray((0.5 * scatter_px2) ** 2 * (far**2 + near**2))


def _model_variance(
    view: SimulatedView, reference: FloatArray, psf: Psf | PsfField, noise: FloatArray | None
) -> FloatArray | None:
    if reference.ndim == 2:
        return model_variance(view, psf, reference, noise)
    planes = [
        model_variance(view, psf, reference[:, :, k], None if noise is None else noise[:, :, k])
        for k in range(reference.shape[2])
    ]
    known = [plane for plane in planes if plane is not None]
    return np.stack(known, axis=-1) if known else None
