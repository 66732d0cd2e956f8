"""Linearity of a camera: how closely its level follows the exposure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LOW, HIGH = 0.05, 0.95
"""Range of levels, as a share of saturation (EMVA 1288 release 4.0, section 6.7)."""

_FEWEST_LEVELS = 3
_LATER_S = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearity:
    """Relative deviations of the level from a straight line over the exposure.

    ``light_drift_per_s`` is the relative change of the light, None if no exposure was captured
    twice.
    """

    mean_deviation: float
    worst_deviation: float
    exposures_us: tuple[float, ...]
    light_dn: tuple[float, ...]
    deviations: tuple[float, ...]
    light_drift_per_s: float | None


def measure_linearity(
    levels: Sequence[tuple[float, float, float]], *, range_dn: float
) -> Linearity | None:
    """Fit a line to level over exposure, with relative weights.

    If exposures were captured more than once, a steady drift of the light is fitted and removed;
    otherwise it counts as deviation.

    Parameters
    ----------
    levels
        Exposure in us, time in s and level above black in DN of each flat.
    range_dn
        Saturation minus black level.

    Returns
    -------
    Linearity or None
        None if fewer than three exposures are between 5 and 95 % of saturation.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 6.7: the linearity error is the mean
    of the absolute relative deviations.
    """
    kept = [entry for entry in levels if LOW * range_dn <= entry[2] <= HIGH * range_dn]
    if len({exposure for exposure, _, _ in kept}) < _FEWEST_LEVELS:
        return None
    exposure, time, light = (np.array(column) for column in zip(*kept, strict=True))
    unit = exposure / exposure.max()
    columns = [unit, np.ones_like(unit)]
    elapsed = time - time.min()
    has_drift = _is_repeated(exposure, elapsed) and exposure.size > _FEWEST_LEVELS + 1
    if has_drift:
        columns.append(unit * elapsed / elapsed.max())
    design = np.stack(columns, axis=1)
    values, *_ = np.linalg.lstsq(design / light[:, None], np.ones_like(light), rcond=None)
    deviation = light / (design @ values) - 1.0
    return Linearity(
        mean_deviation=float(np.mean(np.abs(deviation))),
        worst_deviation=float(np.max(np.abs(deviation))),
        exposures_us=tuple(exposure.tolist()),
        light_dn=tuple(light.tolist()),
        deviations=tuple(deviation.tolist()),
        light_drift_per_s=float(values[2] / values[0] / elapsed.max()) if has_drift else None,
    )


def _is_repeated(exposure: np.ndarray, elapsed: np.ndarray) -> bool:
    return any(
        float(np.ptp(elapsed[exposure == value])) > _LATER_S for value in np.unique(exposure)
    )
