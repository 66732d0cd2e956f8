"""Has the lens moved? Two calibrations compared, and the neighbours of one by its errors."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import erfc, hypot, sqrt
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc

from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.psf._document import PsfCalibration
from calibration.psf._field import FieldFit
from calibration.psf._repeatability import scatter_err
from calibration.psf._transfer_2d import Transfer2d
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf, Psf, PsfField
from simulation.uncertainty import PsfStep, principal_steps

PARAMETERS = (
    "sigma_x_px",
    "sigma_y_px",
    "rho",
    "optical_sigma_x_px",
    "optical_sigma_y_px",
    "optical_rho",
)
"""The parameters compared, as psf.json names them."""

_WIDTHS = ("sigma_x_px", "sigma_y_px")

CHANGED_P = 0.01
"""Significance level, over all parameters together, below which a change counts as real."""

_NO_CAPTURES = (".json", ".toml")  # noise and limits, which many calibrations may share
_NAMED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterChange:
    """One parameter in both calibrations, and a z-test of their difference.

    ``p_value`` is two-sided; ``p_value_holm`` is the same after Holm's correction for testing
    several parameters (Holm, "A simple sequentially rejective multiple test procedure",
    Scandinavian Journal of Statistics 6, 1979).
    """

    name: str
    first: float
    first_err: float
    second: float
    second_err: float
    p_value_holm: float

    @property
    def difference(self) -> float:
        """Second minus first."""
        return self.second - self.first

    @property
    def difference_err(self) -> float:
        """Standard error of the difference."""
        return hypot(self.first_err, self.second_err)

    @property
    def z(self) -> float:
        """Difference divided by its standard error."""
        return self.difference / self.difference_err

    @property
    def p_value(self) -> float:
        """Probability of a difference at least this large if nothing has changed."""
        return _two_sided(self.z)

    @property
    def is_changed(self) -> bool:
        """Whether the change is significant."""
        return self.p_value_holm < CHANGED_P

    def to_json(self) -> dict[str, Any]:
        """Return both values and the test as plain values."""
        derived = ("difference", "z", "p_value", "is_changed")
        return {**asdict(self), **{name: getattr(self, name) for name in derived}}


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfChange:
    """Tests of all parameters that both calibrations give, and why the two may not be comparable.

    With ``shared_inputs``, measured on by both, errors are not independent: no test tells.
    """

    parameters: tuple[ParameterChange, ...]
    remarks: tuple[str, ...]
    shared_inputs: tuple[str, ...] = ()

    @property
    def changed(self) -> tuple[ParameterChange, ...]:
        """Parameters that have changed significantly; none if there are shared inputs."""
        if self.shared_inputs:
            return ()
        return tuple(one for one in self.parameters if one.is_changed)

    @property
    def verdict(self) -> str:
        """One line that says whether the PSF has changed."""
        if self.shared_inputs:
            return (
                f"no verdict: both are calibrations of the same captures "
                f"({_listed(self.shared_inputs)}), but the test needs independent ones; "
                "calibrate from other photographs"
            )
        if not self.changed:
            return (
                f"no significant change in {len(self.parameters)} parameters "
                f"(smallest p = {min(one.p_value_holm for one in self.parameters):.2g})"
            )
        parts = [_described(one) for one in self.changed]
        return f"the PSF has changed: {', '.join(parts)}"


def psf_change(first: PsfCalibration, second: PsfCalibration) -> PsfChange:
    """Compare two calibrations by a z-test of each parameter that both give with an error.

    The remarks name what is left out. Without a common width it is a `CalibrationError`.
    """
    pairs = [(name, _known(first, name), _known(second, name)) for name in PARAMETERS]
    known = [(name, a, b) for name, a, b in pairs if a is not None and b is not None]
    if not any(name in _WIDTHS for name, _, _ in known):
        raise CalibrationError(
            f"no width in common: {_lacking(first, second, _WIDTHS)}; write both with "
            "standoff calibrate, from edges of the same orientations"
        )
    left_out = [
        name
        for name, a, b in pairs
        if (a is None) != (b is None) or (a is None and name in _WIDTHS)
    ]
    not_compared = [f"not compared: {_lacking(first, second, left_out)}"] if left_out else []
    p_values = [_two_sided((b.value - a.value) / hypot(a.err, b.err)) for _, a, b in known]
    return PsfChange(
        parameters=tuple(
            ParameterChange(
                name=name,
                first=a.value,
                first_err=a.err,
                second=b.value,
                second_err=b.err,
                p_value_holm=p_holm,
            )
            for (name, a, b), p_holm in zip(known, _holm(p_values), strict=True)
        ),
        remarks=(*_remarks(first, second), *not_compared),
        shared_inputs=_shared_inputs(first, second),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _FocusRepeatability:
    """Scatter of the PSF's variance, averaged over both axes, between calibrations of a camera.

    ``scatter_px2`` is beyond the calibrations' own errors, ``p_value`` of so much difference
    between them if there were none.
    """

    scatter_px2: float
    scatter_err_px2: float
    calibrations: int
    p_value: float

    def __str__(self) -> str:
        return (
            f"focus scatter between {self.calibrations} calibrations: {self.scatter_px2:.4f} ± "
            f"{self.scatter_err_px2:.4f} px^2 (p = {self.p_value:.2g})"
        )


def focus_repeatability(psfs: Sequence[PsfCalibration]) -> _FocusRepeatability | None:
    """Return how well the focus of a camera repeats from calibration to calibration.

    Calibrations of the same captures count once, and of several methods, colours or parts of the
    frame those that there are most of. None with fewer than two that give both widths.
    """
    chosen = independent_calibrations(psfs)
    known = [found for psf in chosen if (found := _mean_variance(psf)) is not None]
    if len(known) < 2:
        return None
    variance, err = np.array(known).T
    freedom = variance.size - 1
    plain = 1 / err**2
    surplus = float(np.sum(plain * (variance - np.average(variance, weights=plain)) ** 2))
    scatter2 = _between(variance, err)
    weight = 1 / (err**2 + scatter2)
    # Information of the restricted likelihood on the variance between (Searle et al. 1992, 6.6).
    power = float(weight.sum() - np.sum(weight**2) / weight.sum())
    spread2 = sqrt(2 * freedom) / power
    scatter = sqrt(scatter2)
    return _FocusRepeatability(
        scatter_px2=scatter,
        scatter_err_px2=scatter_err(scatter2, spread2),
        calibrations=len(known),
        p_value=float(chdtrc(freedom, surplus)),
    )


def independent_calibrations(psfs: Sequence[PsfCalibration]) -> list[PsfCalibration]:
    """Return calibrations of one kind, the most frequent, of different captures."""
    chosen: list[PsfCalibration] = []
    kinds = Counter((psf.method, psf.channel, psf.region) for psf in psfs)
    for psf in psfs:
        if (psf.method, psf.channel, psf.region) != kinds.most_common(1)[0][0]:
            continue
        if not any(_shared_inputs(other, psf) for other in chosen):
            chosen.append(psf)
    return chosen


def _mean_variance(psf: PsfCalibration) -> tuple[float, float] | None:
    """Mean of both variances and its error, of what the calibrations' edges tell."""
    x, y = psf.estimate("sigma_x_px"), psf.estimate("sigma_y_px")
    if x is None or y is None or not (x.err > 0 and y.err > 0):
        return None
    slopes = np.array([x.value, y.value])  # of (x^2 + y^2) / 2
    joint = np.diag([x.err**2, y.err**2])
    if psf.estimate_covariance is not None:
        joint = np.array(psf.estimate_covariance)[:2, :2]
    return 0.5 * (x.value**2 + y.value**2), sqrt(float(slopes @ joint @ slopes))


def _between(variance: FloatArray, err: FloatArray) -> float:
    """Variance between calibrations beyond their errors (Paule and Mandel 1982)."""

    def surplus(scatter2: float) -> float:
        weight = 1 / (err**2 + scatter2)
        away = variance - np.average(variance, weights=weight)
        return float(np.sum(weight * away**2)) - (variance.size - 1)

    if surplus(0.0) <= 0:
        return 0.0
    most = float(np.sum((variance - variance.mean()) ** 2))
    return float(brentq(surplus, 0.0, most, rtol=1e-10))


def _shared_inputs(first: PsfCalibration, second: PsfCalibration) -> tuple[str, ...]:
    """Names of the captures of the second that are of the first too, by their content."""
    if first.provenance is None or second.provenance is None:
        return ()
    known = {file.sha256 for file in first.provenance.inputs}
    return tuple(
        file.path
        for file in second.provenance.inputs
        if file.sha256 in known and not file.path.endswith(_NO_CAPTURES)
    )


def _listed(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - _NAMED} more" * (len(names) > _NAMED)
    return ", ".join(names[:_NAMED]) + more


def _two_sided(z: float) -> float:
    return erfc(abs(z) / sqrt(2))


def _holm(p_values: list[float]) -> list[float]:
    """Adjusted p-values in the order given, never decreasing with rank."""
    adjusted = [0.0] * len(p_values)
    least = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=lambda k: p_values[k])):
        least = max(least, min((len(p_values) - rank) * p_values[index], 1.0))
        adjusted[index] = least
    return adjusted


def _described(one: ParameterChange) -> str:
    if "rho" in one.name:
        return f"{one.name} by {one.difference:+.4f} (p = {one.p_value_holm:.1g})"
    share = 100 * one.difference / one.first
    return f"{one.name} by {share:+.2f} % (p = {one.p_value_holm:.1g})"


def _known(psf: PsfCalibration, name: str) -> Estimate | None:
    """A parameter that can be compared: one with a standard error."""
    found = psf.estimate(name)
    return found if found is not None and found.err > 0 else None


def _lacking(first: PsfCalibration, second: PsfCalibration, names: Sequence[str]) -> str:
    """Say which of the parameters each of them does not determine, or gives without an error."""
    said = []
    for which, psf in (("first", first), ("second", second)):
        missing = [name for name in names if _known(psf, name) is None]
        open_ones = ", ".join(name for name in missing if getattr(psf, name) is None)
        bare = ", ".join(name for name in missing if getattr(psf, name) is not None)
        if open_ones:
            said.append(f"the {which} does not determine {open_ones}")
        if bare:
            said.append(f"the {which} has no standard error of {bare}")
    return "; ".join(said)


def _remarks(first: PsfCalibration, second: PsfCalibration) -> tuple[str, ...]:
    remarks = []
    for name, what in (("method", "methods"), ("region", "regions"), ("channel", "channels")):
        a, b = getattr(first, name), getattr(second, name)
        if a != b:
            remarks.append(f"they use different {what}: {a or 'none'} and {b or 'none'}")
    serials = [psf.camera.serial if psf.camera else None for psf in (first, second)]
    if None not in serials and serials[0] != serials[1]:
        remarks.append(f"they are from different cameras: {serials[0]} and {serials[1]}")
    return tuple(remarks)


_GAUSSIAN_WIDTHS = ("sigma_x_px", "sigma_y_px", "rho")


def psf_steps(
    calibration: PsfCalibration, psf: Psf | PsfField, zoom: float
) -> tuple[PsfStep, ...] | None:
    """Return independent steps of one standard error from the PSF that was taken.

    None where the calibration does not state the error of this PSF. The zoom need only be about
    right. Errors of a field's coefficients are taken as independent, which is too large at the
    border.
    """
    if isinstance(psf, PsfField):
        return None if calibration.field is None else _of_field(calibration.field, psf)
    measured = calibration.transfer_2d
    if measured is not None and measured.psf(psf.gaussian) == psf:
        return _of_transfer(measured, psf.gaussian, zoom)
    return _of_widths(calibration, psf, zoom) if isinstance(psf, GaussianPsf) else None


def focus_scatter_px2(calibration: PsfCalibration) -> float | None:
    """Scatter of the PSF's variance from capture to capture, None where it was not measured."""
    return None if calibration.focus is None else calibration.focus.scatter_px2


def _of_transfer(
    measured: Transfer2d, gaussian: GaussianPsf, zoom: float
) -> tuple[PsfStep, ...] | None:
    names = tuple(measured.parameters)

    def psf_of(values: FloatArray) -> Psf:
        parameters = dict(zip(names, values.tolist(), strict=True))
        return measured.model_copy(update={"parameters": parameters}).psf(gaussian)

    values = np.array(list(measured.parameters.values()))
    return principal_steps(psf_of, values, measured.covariance_matrix, zoom)


def _of_widths(
    calibration: PsfCalibration, psf: GaussianPsf, zoom: float
) -> tuple[PsfStep, ...] | None:
    total = calibration.total
    errs = {
        name: estimate.err
        for name in _GAUSSIAN_WIDTHS
        if (estimate := getattr(total, name)) is not None and np.isfinite(estimate.err)
    }
    if not {"sigma_x_px", "sigma_y_px"} <= errs.keys():
        return None
    covariance = np.diag(np.array(list(errs.values())) ** 2)
    joint = total.estimate_covariance
    if joint is not None and joint.shape == covariance.shape:
        covariance = joint

    def psf_of(values: FloatArray) -> Psf:
        return _with_widths(psf, dict(zip(errs, values.tolist(), strict=True)))

    values = np.array([getattr(psf, name) for name in errs])
    return principal_steps(psf_of, values, covariance, zoom)


def _with_widths(psf: GaussianPsf, changed: dict[str, float]) -> GaussianPsf:
    """Return a Gaussian with some of its widths and its correlation changed."""
    known = {name: getattr(psf, name) for name in _GAUSSIAN_WIDTHS}
    return GaussianPsf(**{**known, **changed})


def _of_field(fit: FieldFit, field: PsfField) -> tuple[PsfStep, ...] | None:
    if fit.coefficients_err_px2 is None:
        return None
    errs = np.array(fit.coefficients_err_px2)
    if errs.shape != field.coefficients_px2.shape:
        return None
    return tuple(_field_steps(field, errs))


def _field_steps(field: PsfField, errs: FloatArray) -> Iterator[PsfStep]:
    for index in zip(*np.nonzero(errs), strict=True):
        sides = []
        for sign in (1.0, -1.0):
            coefficients = field.coefficients_px2.copy()
            coefficients[index] += sign * errs[index]
            sides.append(replace(field, coefficients_px2=coefficients))
        yield PsfStep(plus=sides[0], minus=sides[1], length=2.0)
