"""What the edges of a planned session will tell about the PSF, before any frame.

The edge is the one that ``calibration.edge_fit`` fits: two levels, a Gaussian rise, an offset, a
turn and a curvature, in a band of pixels on either side. The pixels of a slanted edge lie at all
distances from it, so that sums over pixels are integrals over the band; what varies along the edge
is a power of the place, whose means are known. For white noise and a wide band the error has a
closed form.

The calibration fits one transfer function to the pixels of all edges at once. What an edge's pixels
tell about a parameter of it follows from the edge spread function, ``1/2 + integral of H(f) sin(2
pi f d) / (pi f)``, whose derivatives need no more than those of ``H``: any lens will do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, pi, radians, sin, sqrt

import numpy as np
from scipy.special import ndtr

from calibration.edges import band_half_width, orientation_of
from calibration.noise import LevelNoise
from calibration.psf import Transfer2d, fit_covariance
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf

_STEPS = 801
_OFFSET, _CURVATURE, _LOG_SIGMA, _LOW, _HIGH = range(5)
_SQUARE, _FOURTH = 1 / 3, 1 / 5
"""Means of the second and fourth power of the place along the edge, from -1 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeLevels:
    """Mean levels on both sides of an edge, and the noise of one frame.

    ``low_dn, high_dn``: dark and bright level. ``frame_noise``: variance of a pixel of a single
    frame by its level.
    """

    low_dn: float
    high_dn: float
    frame_noise: LevelNoise

    def __post_init__(self) -> None:
        if not self.low_dn < self.high_dn:
            raise ValueError(f"levels must rise, got {self.low_dn:g} and {self.high_dn:g} DN")

    @property
    def contrast_dn(self) -> float:
        """Step between the levels."""
        return self.high_dn - self.low_dn

    def noise_dn(self, frames: int) -> float:
        """Standard deviation of a pixel of the mean of ``frames``, half-way up the edge."""
        middle = np.array([0.5 * (self.low_dn + self.high_dn)])
        return sqrt(float(self.frame_noise.variance_dn2(middle)[0]) / frames)


def sigma_err_px(sigma_px: float, length_px: float, levels: EdgeLevels, frames: int) -> float:
    """Return the least standard error of the total width of one edge (Cramer and Rao)."""
    covariance = np.linalg.inv(_edge_information(sigma_px, levels))
    return sigma_px * sqrt(float(covariance[_LOG_SIGMA, _LOG_SIGMA]) / (length_px * frames))


def _edge_information(sigma_px: float, levels: EdgeLevels) -> FloatArray:
    """Return the Fisher information of one px of edge in one frame.

    In this order: offset, curvature (px at the ends), logarithm of sigma, low and high level. The
    turn is independent of them: its derivative is odd along the edge.
    """
    half_width_px = band_half_width(sigma_px)
    distance_px, step_px = np.linspace(-half_width_px, half_width_px, _STEPS, retstep=True)
    x = distance_px / sigma_px
    rise = ndtr(x)
    density = np.exp(-0.5 * x * x) / sqrt(2 * pi)
    weight = step_px / levels.frame_noise.variance_dn2(
        levels.low_dn + levels.contrast_dn * np.asarray(rise)
    )
    slopes = np.stack(
        [
            levels.contrast_dn * density / sigma_px,
            levels.contrast_dn * density / sigma_px,
            levels.contrast_dn * x * density,
            1 - rise,
            rise,
        ]
    )
    information = (slopes * weight) @ slopes.T
    information[_CURVATURE] *= _SQUARE
    information[:, _CURVATURE] *= _SQUARE
    information[_CURVATURE, _CURVATURE] *= _FOURTH / _SQUARE**2
    return np.asarray(information)


def white_noise_sigma_err_px(sigma_px: float, length_px: float, snr: float) -> float:
    """Return the error of a width in white noise where the levels are known: a closed form.

    The information about log sigma is ``length snr^2 sigma`` times the integral of ``x^2
    phi(x)^2``, which is ``1 / (4 sqrt(pi))``. With levels to be found in a finite band it is a
    bound from below.
    """
    return 2 * sqrt(sqrt(pi) * sigma_px / length_px) / snr


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedEdge:
    """One edge of one planned capture.

    ``capture``: number of the capture; edges of one capture share its focus. ``angle_deg``:
    direction of the edge line from +x, y down.
    """

    capture: int
    angle_deg: float
    length_px: float

    @property
    def normal(self) -> tuple[float, float]:
        """Unit normal (x, y)."""
        turn = radians(self.angle_deg + 90.0)
        return cos(turn), sin(turn)


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSession:
    """The planned edges, and what their pixels are like.

    ``levels``: levels and noise of one frame, the same for all edges. ``frames``: frames of a
    capture. ``focus_scatter_px2``: standard deviation of the PSF's variance from capture to
    capture, in every direction.
    """

    edges: tuple[PlannedEdge, ...]
    levels: EdgeLevels
    frames: int
    focus_scatter_px2: float = 0.0

    @property
    def same_capture(self) -> FloatArray:
        """Matrix of shape (edges, edges): 1 where two edges are of one capture."""
        capture = np.array([edge.capture for edge in self.edges])
        return np.asarray(capture[:, None] == capture, dtype=np.float64)

    def widths_px(self, covariance_px2: FloatArray) -> FloatArray:
        """Total width across each edge for a PSF of this covariance, shape (edges,)."""
        normal = np.array([edge.normal for edge in self.edges])
        return np.asarray(np.sqrt(np.einsum("na,ab,nb->n", normal, covariance_px2, normal)))

    def width_errs_px(self, covariance_px2: FloatArray) -> FloatArray:
        """Standard error of each width by the noise of the pixels, shape (edges,)."""
        per_root_px = {
            width: sigma_err_px(width, 1.0, self.levels, self.frames)
            for width in set(self.widths_px(covariance_px2).tolist())
        }
        return np.array(
            [
                per_root_px[width] / sqrt(edge.length_px)
                for width, edge in zip(
                    self.widths_px(covariance_px2).tolist(), self.edges, strict=True
                )
            ]
        )


def edges_of_captures(
    orientations_deg: Sequence[float], template: Sequence[tuple[float, float]]
) -> tuple[PlannedEdge, ...]:
    """Return the edges of captures at these orientations of a target.

    ``template``: angle against the target's orientation, and length in px, of each edge of a
    capture.
    """
    return tuple(
        PlannedEdge(
            capture=number, angle_deg=(orientation_deg + angle_deg) % 180.0, length_px=length_px
        )
        for number, orientation_deg in enumerate(orientations_deg)
        for angle_deg, length_px in template
    )


_LEAST_ERR_PX = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WidthErrors:
    """Covariances of the errors of sigma_x_px, sigma_y_px and rho, in this order, by source.

    Without edges that determine the correlation its rows are 0: it is taken as 0, not measured. An
    axis without edges is not ``determined``.
    """

    pixels: FloatArray
    focus: FloatArray
    is_determined: tuple[bool, bool, bool]

    @property
    def total(self) -> FloatArray:
        """Covariance by all sources."""
        return np.asarray(self.pixels + self.focus)


def width_errors(session: EdgeSession, covariance_px2: FloatArray) -> WidthErrors:
    """Predict the errors of the widths.

    The calibration fits squared widths, which are linear in the elements of the covariance, with
    weights by the errors of the edges and by the scatter beyond them. Its estimate is therefore a
    known linear function of what each edge says; errors by the focus are common to the edges of a
    capture, those by the pixels are not. ``covariance_px2``: covariance of the total PSF, shape (2,
    2).
    """
    width = session.widths_px(covariance_px2)
    noise = np.maximum(session.width_errs_px(covariance_px2), _LEAST_ERR_PX)
    # A change of the variance by v moves a width by v / (2 sigma).
    by_focus = session.focus_scatter_px2 / (2 * width)
    spread = np.hypot(noise, by_focus)
    design, elements = _design(session, width, spread)
    to_element = np.zeros((3, len(width)))
    if elements:
        weighted = design / (2 * width * spread)[:, None] ** 2
        # An edge that the fit leaves out has a row of zeros.
        to_element[elements] = np.linalg.solve(weighted.T @ design, weighted.T)
    to_width = _slopes(covariance_px2) @ to_element
    if 1 not in elements:
        to_width[2] = 0.0
    by_pixels = to_width * (2 * width * noise)
    by_capture = to_width * session.focus_scatter_px2
    return WidthErrors(
        pixels=np.asarray(by_pixels @ by_pixels.T),
        focus=np.asarray(by_capture @ session.same_capture @ by_capture.T),
        is_determined=(0 in elements, 2 in elements, 1 in elements),
    )


def _design(
    session: EdgeSession, width: FloatArray, spread: FloatArray
) -> tuple[FloatArray, list[int]]:
    """Derivatives of squared widths by the elements that the calibration will fit, and which."""
    normal = np.array([edge.normal for edge in session.edges])
    x, y = normal.T
    full = np.column_stack([x**2, 2 * x * y, y**2])
    angles_deg = np.array([edge.angle_deg for edge in session.edges])
    expected = fit_covariance(angles_deg, width, spread)
    if expected.rho is not None:
        return full, [0, 1, 2]
    elements = [
        number
        for number, estimate in ((0, expected.sigma_x_px), (2, expected.sigma_y_px))
        if estimate is not None
    ]
    names = np.array([orientation_of(angle) for angle in angles_deg.tolist()])
    if len(elements) == 2:
        return full[:, elements] * (names != "diagonal")[:, None], elements
    of_axis = names == ("vertical" if elements == [0] else "horizontal")
    # With one axis alone, a width across its edges is taken as the axis's own.
    return of_axis[:, None].astype(np.float64), elements


def _slopes(covariance_px2: FloatArray) -> FloatArray:
    """Derivatives of both widths and the correlation by the elements xx, xy and yy."""
    (xx, xy), (_, yy) = covariance_px2.tolist()
    x, y = np.sqrt([xx, yy]).tolist()
    rho = xy / (x * y)
    return np.array(
        [[0.5 / x, 0.0, 0.0], [0.0, 0.0, 0.5 / y], [-0.5 * rho / xx, 1 / (x * y), -0.5 * rho / yy]]
    )


HALF_NYQUIST_CY_PER_PX = 0.25

_FREQUENCIES = 200
_FREQ_MOST_CY_PER_PX = 2.0
_DISTANCES = 801
_HALF_WIDTH_PX = 20.0
_STEP = 1e-4  # relative, of a parameter
_LEAST_STEP = 1e-6

Otf = Callable[[FloatArray, FloatArray], FloatArray]
"""Transfer at frequencies along x and y, in cy/px; the two broadcast."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownTransfer:
    """The errors of an earlier calibration, and how much its edges knew.

    ``err``: standard error of the transfer at frequencies along x and y. ``scatter``: factor on the
    pixels' variance that it contains for the scatter between edges. ``information_per_px2``: sum of
    the inverse variances of the widths of its edges.
    """

    err: Otf
    scatter: float
    information_per_px2: float

    def variance(self, session: EdgeSession, covariance_px2: FloatArray, at: FloatArray) -> float:
        """Variance at a frequency if so many more, or fewer, pixels tell of it."""
        planned = float(np.sum(session.width_errs_px(covariance_px2) ** -2.0))
        err = float(self.err(at[:1], at[1:])[0])
        return err**2 / self.scatter * self.information_per_px2 / planned


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferModel:
    """A transfer function of the form that the calibration is expected to choose.

    ``of, parameters``: returns it for any parameters; the present ones. ``known``: what an earlier
    calibration knew of it, for a form whose smoothness is fitted as well: its information does not
    follow from the form alone. None for other forms.
    """

    of: Callable[[FloatArray], Otf]
    parameters: FloatArray
    known: "KnownTransfer | None" = None

    @classmethod
    def of_calibration(
        cls, stored: Transfer2d | None, gaussian: GaussianPsf, sigma_errs_px: Sequence[float]
    ) -> "TransferModel":
        """Return that of a psf.json, or the Gaussian of its widths where it has none.

        ``sigma_errs_px`` are the errors of the widths of its edges.
        """
        if stored is None:
            return cls.of_gaussian(gaussian.covariance_px2)
        names = tuple(stored.parameters)

        def of(values: FloatArray) -> Otf:
            named = dict(zip(names, values.tolist(), strict=True))
            return stored.model_copy(update={"parameters": named}).otf

        known = None
        if stored.form == "free":
            known = KnownTransfer(
                err=stored.otf_err,
                scatter=stored.scatter,
                information_per_px2=sum(err**-2 for err in sigma_errs_px if err > 0),
            )
        return cls(of=of, parameters=np.array(list(stored.parameters.values())), known=known)

    @classmethod
    def of_gaussian(cls, covariance_px2: FloatArray) -> "TransferModel":
        """Return a Gaussian of lens and pixel together."""

        def of(values: FloatArray) -> Otf:
            xx, xy, yy = values.tolist()

            def otf(fx: FloatArray, fy: FloatArray) -> FloatArray:
                power = xx * fx**2 + 2 * xy * fx * fy + yy * fy**2
                return np.asarray(np.exp(-2 * np.pi**2 * power))

            return otf

        return cls(of=of, parameters=covariance_px2[[0, 0, 1], [0, 1, 1]])

    def slopes(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Derivatives of the transfer by the parameters, shape (parameters, frequencies)."""
        rows = []
        for number, value in enumerate(self.parameters.tolist()):
            step = max(abs(value) * _STEP, _LEAST_STEP)
            moved = self.parameters.copy()
            moved[number] = value + step
            above = self.of(moved)(fx, fy)
            # Some parameters are never negative.
            moved[number] = max(value - step, min(value, 0.0)) if value >= 0 else value - step
            below = self.of(moved)(fx, fy)
            rows.append((above - below) / (value + step - moved[number]))
        return np.array(rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferErrors:
    """The transfer at one frequency along an axis, and the variances of its errors by source.

    ``pixels`` and ``focus`` are None where the planned edges do not determine the form.
    """

    value: float
    pixels: float | None
    focus: float | None


def transfer_errors(
    session: EdgeSession,
    model: TransferModel,
    freq_cy_per_px: tuple[float, float],
    covariance_px2: FloatArray,
) -> TransferErrors:
    """Predict the error of the transfer at a frequency.

    ``covariance_px2``: of the Gaussian nearest to it, shape (2, 2).
    """
    if model.known is not None:
        return _as_before(session, model, np.array(freq_cy_per_px), covariance_px2)
    count = len(model.parameters)
    information = np.zeros((count, count))
    pulls = {edge.capture: np.zeros(count) for edge in session.edges}
    known: dict[float, tuple[FloatArray, FloatArray]] = {}
    for edge in session.edges:
        if edge.angle_deg not in known:
            known[edge.angle_deg] = _information(session, edge, model)
        own, by_focus = known[edge.angle_deg]
        information += edge.length_px * own
        pulls[edge.capture] = pulls[edge.capture] + edge.length_px * by_focus
    fx, fy = (np.array([value]) for value in freq_cy_per_px)
    value = float(model.of(model.parameters)(fx, fy)[0])
    scale = np.sqrt(np.diag(information))
    if not np.all(scale > 0) or np.linalg.cond(information / np.outer(scale, scale)) > 1e12:
        return TransferErrors(value=value, pixels=None, focus=None)
    slope = model.slopes(fx, fy)[:, 0]
    gain = np.linalg.solve(information, slope)
    by_capture = np.array([pull @ gain for pull in pulls.values()]) * session.focus_scatter_px2
    return TransferErrors(
        value=value, pixels=float(slope @ gain), focus=float(by_capture @ by_capture)
    )


def _as_before(
    session: EdgeSession, model: TransferModel, at: FloatArray, covariance_px2: FloatArray
) -> TransferErrors:
    """Scale the errors of an earlier calibration; captures count alike in what the focus does."""
    value = float(model.of(model.parameters)(at[:1], at[1:])[0])
    if model.known is None or not model.known.information_per_px2 > 0:
        return TransferErrors(value=value, pixels=None, focus=None)
    captures = len({edge.capture for edge in session.edges})
    common = 2 * np.pi**2 * float(at @ at) * value * session.focus_scatter_px2
    return TransferErrors(
        value=value,
        pixels=model.known.variance(session, covariance_px2, at),
        focus=common**2 / captures,
    )


def _information(
    session: EdgeSession, edge: PlannedEdge, model: TransferModel
) -> tuple[FloatArray, FloatArray]:
    """Information of one px of an edge, and how a px^2 of more variance pulls at it.

    Offset and levels are projected out.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_FREQUENCIES)
    freq = 0.5 * _FREQ_MOST_CY_PER_PX * (nodes + 1)
    share = 0.5 * _FREQ_MOST_CY_PER_PX * weights
    x, y = edge.normal
    fx, fy = freq * x, freq * y
    distance, step = np.linspace(-_HALF_WIDTH_PX, _HALF_WIDTH_PX, _DISTANCES, retstep=True)
    sine = np.sin(2 * np.pi * distance[:, None] * freq) * (share / (np.pi * freq))
    cosine = 2 * np.cos(2 * np.pi * distance[:, None] * freq) * share
    otf = model.of(model.parameters)(fx, fy)
    rise = 0.5 + sine @ otf
    levels = session.levels
    variance = levels.frame_noise.variance_dn2(levels.low_dn + levels.contrast_dn * rise)
    root = np.sqrt(step * session.frames / variance)
    defocused = -2 * np.pi**2 * freq**2 * otf
    asked = np.column_stack([sine @ model.slopes(fx, fy).T, sine @ defocused])
    asked *= levels.contrast_dn * root[:, None]
    nuisance = np.column_stack([cosine @ otf, 1 - rise, rise]) * root[:, None]
    basis, _ = np.linalg.qr(nuisance)
    asked -= basis @ (basis.T @ asked)
    slopes, focus = asked[:, :-1], asked[:, -1]
    return np.asarray(slopes.T @ slopes), np.asarray(slopes.T @ focus)
