"""The predictions of a study: each quantity with the variances of its error by source."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from analysis.study.change_errors import (
    ChangeSensitivities,
    Sensitivity,
    StudiedScene,
    change_sensitivities,
)
from analysis.study.document import Quantity
from analysis.study.planned_edges import EdgeSession
from analysis.study.pupil_errors import BoardSession, pupil_errors
from analysis.study.sources import NORMAL_95, Prediction, Source
from analysis.study.transfer_errors import (
    HALF_NYQUIST_CY_PER_PX,
    TransferModel,
    transfer_errors,
)
from analysis.study.width_errors import WidthErrors, width_errors
from simulation.psf import GaussianPsf, Psf

_NO_EDGES = "the plan has no capture of kind edge"
_NO_BOARD = "the plan has no captures of kind board at two heights in which 12 corners are in view"
_NO_LIMIT = "within zoom 2.5 nothing limits it, or d' is below the threshold at equal poses"
_NO_CAMERA = "the size of the frame is not known: give the bench a region_px"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudiedPlan:
    """All that a study looks at.

    ``edges``: the planned edges; None without any. ``psf, gaussian``: total PSF as measured, and
    the Gaussian nearest to it. ``transfer``: its transfer function. ``board``: the planned captures
    of a board; None without any, or where the frame is not known. ``pupil_offset_mm``: known from
    an earlier session; None if not.
    """

    edges: EdgeSession | None
    psf: Psf
    gaussian: GaussianPsf
    transfer: TransferModel
    board: BoardSession | None
    pupil_offset_mm: float | None
    scene: StudiedScene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyPredictions:
    """The predictions, and the sensitivities of d'."""

    predictions: tuple[Prediction, ...]
    sensitivities: ChangeSensitivities


def studied(plan: StudiedPlan) -> StudyPredictions:
    """Predict the error of every quantity."""
    widths = None
    if plan.edges is not None:
        widths = width_errors(plan.edges, plan.gaussian.covariance_px2)
    sensitivities = change_sensitivities(plan.scene, plan.psf, plan.gaussian)
    found = [
        _width(plan, widths, 0, "sigma_x_px"),
        _width(plan, widths, 1, "sigma_y_px"),
        _transfer(plan, "transfer_x", (HALF_NYQUIST_CY_PER_PX, 0.0)),
        _transfer(plan, "transfer_y", (0.0, HALF_NYQUIST_CY_PER_PX)),
        _pupil(plan),
        _change(plan, widths, sensitivities.d_prime, "d_prime", ""),
        _change(
            plan,
            widths,
            sensitivities.tilt_deg,
            "tilt_limit_deg",
            _NO_CAMERA if plan.scene.camera is None else _NO_LIMIT,
        ),
    ]
    return StudyPredictions(predictions=tuple(found), sensitivities=sensitivities)


def _width(
    plan: StudiedPlan, widths: WidthErrors | None, axis: int, quantity: Quantity
) -> Prediction:
    value = (plan.gaussian.sigma_x_px, plan.gaussian.sigma_y_px)[axis]
    if widths is None:
        return Prediction(quantity=quantity, value=value, variances={}, undetermined=_NO_EDGES)
    if not widths.is_determined[axis]:
        edges = ("vertical", "horizontal")[axis]
        return Prediction(
            quantity=quantity,
            value=value,
            variances={},
            undetermined=f"the plan has no {edges} edges, nor edges at three angles",
        )
    return Prediction(
        quantity=quantity,
        value=value,
        variances={
            "pixel noise of the edges": float(widths.pixels[axis, axis]),
            "focus from capture to capture": float(widths.focus[axis, axis]),
        },
    )


def _transfer(plan: StudiedPlan, quantity: Quantity, freq: tuple[float, float]) -> Prediction:
    if plan.edges is None:
        fx, fy = (np.array([one]) for one in freq)
        value = float(plan.transfer.of(plan.transfer.parameters)(fx, fy)[0])
        return Prediction(quantity=quantity, value=value, variances={}, undetermined=_NO_EDGES)
    errors = transfer_errors(plan.edges, plan.transfer, freq, plan.gaussian.covariance_px2)
    if errors.pixels is None or errors.focus is None:
        return Prediction(
            quantity=quantity,
            value=errors.value,
            variances={},
            undetermined="the planned angles do not determine a transfer function of this form",
        )
    return Prediction(
        quantity=quantity,
        value=errors.value,
        variances={
            "pixel noise of the edges": errors.pixels,
            "focus from capture to capture": errors.focus,
        },
    )


def _pupil(plan: StudiedPlan) -> Prediction:
    errors = None if plan.board is None else pupil_errors(plan.board)
    if errors is None:
        return Prediction(
            quantity="pupil_offset_mm",
            value=plan.pupil_offset_mm,
            variances={},
            undetermined=_NO_BOARD,
        )
    factor = NORMAL_95
    if errors.heights > 0 and errors.degrees_of_freedom > 0:
        factor = float(student_t.ppf(0.975, errors.degrees_of_freedom))
    return Prediction(
        quantity="pupil_offset_mm",
        value=plan.pupil_offset_mm,
        variances={
            "pixel noise of the board": errors.pixels,
            "heights read back": errors.heights,
        },
        half_width_factor=factor,
    )


def _change(
    plan: StudiedPlan,
    widths: WidthErrors | None,
    sensitivity: Sensitivity | None,
    quantity: Quantity,
    why_none: str,
) -> Prediction:
    """A quantity that follows from the PSF, the noise and the scene."""
    if sensitivity is None:
        return Prediction(quantity=quantity, value=None, variances={}, undetermined=why_none)
    if widths is None or not all(widths.is_determined[:2]):
        return Prediction(
            quantity=quantity,
            value=sensitivity.value,
            variances={},
            undetermined="the planned edges do not determine the PSF along both axes",
        )
    slope = sensitivity.by_widths
    variances: dict[Source, float] = {
        "pixel noise of the edges": float(slope @ widths.pixels @ slope),
        "focus from capture to capture": float(slope @ widths.focus @ slope),
        "noise of the camera": (sensitivity.by_log_noise * plan.scene.noise_relative_err) ** 2,
        "photographs of the scene": sensitivity.scene_err**2,
    }
    return Prediction(quantity=quantity, value=sensitivity.value, variances=variances)
