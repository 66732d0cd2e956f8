"""The error of the transfer function that a planned session will measure.

The calibration fits one transfer function to the pixels of all edges at once. What an edge's pixels
tell about a parameter of it follows from the edge spread function, ``1/2 + integral of H(f) sin(2
pi f d) / (pi f)``, whose derivatives need no more than those of ``H``: any lens will do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.study.planned_edges import EdgeSession, PlannedEdge
from calibration.psf import Transfer2d
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf

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
