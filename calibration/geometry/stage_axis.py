"""The stage's travel in the image: how the camera moves sideways as the stage rises."""

from dataclasses import dataclass

import numpy as np

from calibration.geometry.bundle_adjustment import Adjustment
from simulation.arrays import FloatArray

_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StageAxis:
    """The stage's travel as seen by one series.

    Parameters
    ----------
    pierce_px
        Pixel (x, y) from which the image expands: where the line of travel through the pupil
        intersects the image.
    offset_px
        The same, relative to the centre of the image.
    covariance_px2
        Covariance of either, shape (2, 2).
    sideways
        Distance of each capture from the straight line, shape (n, 2), in the unit of the series.
    """

    pierce_px: FloatArray
    offset_px: FloatArray
    covariance_px2: FloatArray
    sideways: FloatArray


def stage_axis(adjustment: Adjustment, number: int) -> StageAxis:
    """Fit a straight line of travel to the positions of one series.

    Parameters
    ----------
    adjustment
        Adjustment of the series, and possibly others.
    number
        Number of the series, which has captures at two distances or more.
    """
    series, layout = adjustment.series[number], adjustment.columns
    columns = np.concatenate(
        [layout.shared(number), *(layout.pose(one.capture) for one in series.captures)]
    )
    lens = series.lens
    shared = lens.parameters
    poses = np.array([one.pose.parameters for one in series.captures])

    def pierce_px(values: FloatArray) -> FloatArray:
        own = values[len(shared) :].reshape(-1, 4)
        drift = _drift(own)
        c, s = np.cos(own[0, 1]), np.sin(own[0, 1])
        slope = -np.array([[c, s], [-s, c]]) @ drift
        return lens.with_parameters(values[: len(shared)]).pixels(slope[None]).ravel()

    values = np.concatenate([shared, poses.ravel()])
    change = np.empty((2, len(values)))
    for column in range(len(values)):
        step = np.zeros(len(values))
        step[column] = _STEP
        change[:, column] = (pierce_px(values + step) - pierce_px(values - step)) / (2 * _STEP)
    covariance = change @ adjustment.covariance[np.ix_(columns, columns)] @ change.T
    distance = np.exp(poses[:, 0])
    offset = distance - distance.mean()
    sideways = poses[:, 2:] - poses[:, 2:].mean(axis=0) - np.outer(offset, _drift(poses))
    if len(poses) > 2:
        # A stage that does not run straight adds to the uncertainty from the images.
        scatter = np.sum(sideways**2) / (2 * (len(poses) - 2)) / np.sum(offset**2)
        wander = np.eye(2) * scatter * lens.focal_length_px**2
        if np.trace(wander) > np.trace(covariance):
            covariance = wander
    middle = np.array([(lens.width_px - 1) / 2, (lens.height_px - 1) / 2])
    pierced = pierce_px(values)
    return StageAxis(
        pierce_px=pierced,
        offset_px=pierced - middle,
        covariance_px2=covariance,
        sideways=sideways,
    )


def _drift(poses: FloatArray) -> FloatArray:
    """Sideways travel (x, y) per unit of travel along the plane's normal."""
    distance = np.exp(poses[:, 0])
    offset = distance - distance.mean()
    return np.asarray(offset @ poses[:, 2:] / (offset @ offset))
