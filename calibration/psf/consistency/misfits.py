"""What the edges tell against the model of one Gaussian camera: a test for each cause.

Each test gives a probability and how much it matters; what is significant and too small to matter
is not named. Captures, not edges, are the units of what captures share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.special import fdtrc, stdtr

from calibration.edges import EdgeMeasurement
from calibration.psf.consistency.document import MisfitKind
from calibration.psf.consistency.scales import side_px
from calibration.psf.consistency.softness import SoftnessFit, direction_columns
from calibration.psf.repeatability import CaptureFit, SharedByCapture, capture_numbers, capture_of
from calibration.psf.variance import fit_variances
from simulation.arrays import FloatArray

_SHAPE_FREQ = np.array([0.125, 0.25, 0.375])  # cy/px: a quarter, half and three quarters of Nyquist
_FEWEST_EDGES = 6
_LEAST_ERR_PX = 1e-9
_WORTH_SHAPE = 0.006  # of a transfer
_WORTH_WIDTH = 0.01  # of a width
_WORTH_STAGE = 0.003  # of a distance
_WORTH_EDGES = 0.015  # of a width


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What speaks against the model: its kind, its probability, whether it matters, a sentence."""

    kind: MisfitKind
    p_value: float
    matters: bool
    sentence: str


def soft_target(softness: SoftnessFit | None) -> Evidence | None:
    """Test whether the target is soft."""
    if softness is None:
        return None
    found = softness.document
    share = 100 * sqrt(max(found.variance_px2, 0.0))
    blur = f"{share / 100:.2f} px in the nearest capture"
    if found.sigma_mm is not None:
        blur += f" ({found.sigma_mm:.3f} mm)"
    return Evidence(
        kind="soft_target",
        p_value=found.p_value if found.is_removed else 1.0,
        matters=found.is_removed,
        sentence=f"the edge target is soft itself: {blur}, from how the widths grow with its "
        "scale; this is taken off, and sigma is that of the camera",
    )


def stage(edges: Sequence[EdgeMeasurement]) -> Evidence | None:
    """Test whether the heights that were read agree with the sizes of squares in the captures."""
    captures: dict[object, list[EdgeMeasurement]] = {}
    for edge in edges:
        captures.setdefault(capture_of(edge), []).append(edge)
    known = [
        (some[0].height_mm, side)
        for some in captures.values()
        if some[0].height_mm is not None and (side := side_px(some)) is not None
    ]
    if len(known) < 4 or len({height for height, _ in known}) < 3:
        return None
    height, side = np.array(known, dtype=np.float64).T
    design = np.column_stack([height, np.ones_like(height)])
    root = side  # relative errors of distances are alike
    values = np.linalg.lstsq(design * root[:, None], np.ones_like(side), rcond=None)[0]
    left = design @ values * side - 1
    freedom = height.size - 2
    relative = sqrt(float(left @ left) / freedom)
    err = _side_err(list(captures.values()))
    p_value = float(fdtrc(freedom, _SIDE_FREEDOM, (relative / err) ** 2))
    away_mm = relative * float(np.mean(height + values[1] / values[0]))
    return Evidence(
        kind="stage",
        p_value=p_value,
        matters=relative > _WORTH_STAGE,
        sentence=f"the heights do not fit the size of the target in the captures: they scatter by "
        f"{away_mm:.2g} mm ({100 * relative:.1f} % of the distance); check the stage",
    )


_SIDE_FREEDOM = 30.0


def _side_err(captures: Sequence[Sequence[EdgeMeasurement]]) -> float:
    """Relative error of the side of a square, from the errors of the widths of its edges.

    Place and width of an edge are about as exact as each other; twice that is allowed for.
    """
    errs = []
    for some in captures:
        side = side_px(some)
        if side is not None:
            mean_px = sqrt(float(np.mean([edge.sigma_err_px**2 for edge in some])))
            errs.append(2 * mean_px / side)
    return max(sqrt(float(np.mean(np.square(errs)))), 1e-6)


def focus_drift(edges: Sequence[EdgeMeasurement], shared: SharedByCapture) -> Evidence | None:
    """Test whether the variance changes along a straight line over the heights."""
    height = height_column(edges)
    if height is None:
        return None
    sigma, err = _widths(edges)
    design = np.column_stack([direction_columns(edges), height])
    if np.linalg.matrix_rank(design, tol=1e-6) < design.shape[1]:
        return None
    fit = fit_variances(design, sigma, err, shared=shared, is_resampled=False)
    slope, slope_err = float(fit.values[-1]), sqrt(float(fit.covariance[-1, -1]))
    last = np.eye(fit.values.size)[-1]
    freedom = float(sigma.size - design.shape[1])
    if fit.by_capture is not None and fit.is_by_capture:
        freedom = min(freedom, fit.by_capture.freedom(last))
    change = slope * float(np.ptp(height)) / (2 * float(np.mean(sigma**2)))
    return Evidence(
        kind="focus_drift",
        p_value=float(2 * stdtr(freedom, -abs(slope) / slope_err)),
        matters=abs(change) > _WORTH_WIDTH,
        sentence=f"the width changes by {100 * abs(change):.1f} % over the heights: the focus "
        "drifts; calibrate at one height or refocus",
    )


def focus_scatter(fit: CaptureFit | None, width_px: float) -> Evidence | None:
    """Test whether captures differ by more than their edges do."""
    if fit is None or fit.is_single:
        return None
    scatter = sqrt(fit.scatter2_px4)
    return Evidence(
        kind="focus_scatter",
        p_value=fit.p_value,
        matters=scatter / (2 * width_px**2) > _WORTH_WIDTH,
        sentence=f"the focus scatters between captures by {scatter:.3f} px^2 "
        f"({100 * scatter / (2 * width_px**2):.1f} % of sigma); the errors hold it: more captures, "
        "or a lens that is locked, make them smaller",
    )


def shape(edges: Sequence[EdgeMeasurement]) -> Evidence | None:
    """Test whether a Gaussian lens with a pixel passes what the edges' own curves show."""
    rows = [_off_gaussian(edge) for edge in edges if edge.esfr is not None]
    known = np.array([row for row in rows if row is not None])
    if len(known) < _FEWEST_EDGES:
        return None
    mean, err = known.mean(axis=0), known.std(axis=0, ddof=1) / sqrt(len(known))
    err = np.maximum(err, 1e-6)
    p_values = 2 * stdtr(len(known) - 1, -np.abs(mean) / err)
    # Only what matters is tested: where the most significant is too small, the largest counts.
    worst = int(np.argmax(np.abs(mean)))
    return Evidence(
        kind="shape",
        p_value=float(min(p_values.size * p_values[worst], 1.0)),
        matters=abs(float(mean[worst])) > _WORTH_SHAPE,
        sentence=f"a Gaussian does not fit this lens: at {_SHAPE_FREQ[worst]:.3f} cy/px the edges "
        f"show {100 * mean[worst]:+.1f} % of contrast beside it; use the measured transfer "
        "(method all-angles), not the Gaussian",
    )


def _off_gaussian(edge: EdgeMeasurement) -> FloatArray | None:
    """Measured transfer less that of the fitted Gaussian, at the frequencies of the test."""
    sigma_px = edge.optical_sigma_px
    if sigma_px is None or edge.esfr is None:
        return None
    cosine, sine = np.cos(edge.normal_rad), np.sin(edge.normal_rad)
    pixel = np.sinc(_SHAPE_FREQ * cosine) * np.sinc(_SHAPE_FREQ * sine)
    gauss = np.exp(-2 * (pi * sigma_px * _SHAPE_FREQ) ** 2) * pixel
    return np.asarray(edge.esfr.transform(_SHAPE_FREQ).real - gauss)


def edges_apart(p_value: float, scatter_px: float, width_px: float) -> Evidence:
    """Name edges that differ within captures, from how badly half of them predicts the rest."""
    return Evidence(
        kind="edges",
        p_value=p_value,
        matters=scatter_px / width_px > _WORTH_EDGES,
        sentence=f"edges of one capture differ by {100 * scatter_px / width_px:.1f} % beyond their "
        "errors: the PSF changes over the frame, or edges are rough; the errors hold it",
    )


def height_column(edges: Sequence[EdgeMeasurement]) -> FloatArray | None:
    """Heights about their middle over their range; None with fewer than three."""
    heights = [edge.height_mm for edge in edges if edge.height_mm is not None]
    if len(heights) < len(edges) or len(set(heights)) < 3:
        return None
    height = np.array(heights)
    return np.asarray((height - height.mean()) / float(np.ptp(height)))


def shared_of(edges: Sequence[EdgeMeasurement], softness: SoftnessFit | None) -> SharedByCapture:
    """Return what the captures of these edges share."""
    if softness is not None:
        return softness.shared(edges)
    numbers = capture_numbers([capture_of(edge) for edge in edges])
    return SharedByCapture.focus_alone(numbers, np.array([edge.normal_rad for edge in edges]))


def _widths(edges: Sequence[EdgeMeasurement]) -> tuple[FloatArray, FloatArray]:
    sigma = np.array([edge.sigma_px for edge in edges])
    err = np.maximum([edge.sigma_err_px for edge in edges], _LEAST_ERR_PX)
    return sigma, np.asarray(err)


def scatter_beside(
    edges: Sequence[EdgeMeasurement], columns: FloatArray | None, shared: SharedByCapture
) -> CaptureFit | None:
    """Fit the scatter between captures beside further columns of the model."""
    sigma, err = _widths(edges)
    design = direction_columns(edges)
    if columns is not None:
        design = np.column_stack([design, columns])
    return fit_variances(design, sigma, err, shared=shared, is_resampled=False).by_capture
