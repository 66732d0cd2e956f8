"""The errors of the PSF's widths that a planned session will have, by source."""

from dataclasses import dataclass

import numpy as np

from analysis.study.planned_edges import EdgeSession
from calibration.edges import orientation_of
from calibration.psf import fit_covariance
from simulation.arrays import FloatArray

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
        [
            [0.5 / x, 0.0, 0.0],
            [0.0, 0.0, 0.5 / y],
            [-0.5 * rho / xx, 1 / (x * y), -0.5 * rho / yy],
        ]
    )
