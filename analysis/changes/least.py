"""Which changes are large enough to be listed."""

from collections.abc import Sequence

import numpy as np

from analysis.changes.colour import Steps
from analysis.changes.document import Change
from analysis.changes.options import ChangeOptions
from simulation.arrays import BoolArray, Float32Array


def large_enough(changes: Sequence[Change], options: ChangeOptions, gain: float) -> BoolArray:
    """Tell the changes whose amplitude is at least what was asked for, or the files' step there.

    Of colours those of which any channel's is.

    Parameters
    ----------
    changes
        All that are significant.
    options
        What was asked for, and the steps.
    gain
        Of light, follow-up over reference: amplitudes are in the follow-up's levels.
    """
    if options.colours is not None and any(one.amplitude_rgb_dn for one in changes):
        steps = options.colours.step_dn
        return np.array([_of_colour(change, options.least_dn, steps, gain) for change in changes])
    amplitudes = np.abs([change.amplitude_dn for change in changes])
    if options.least_dn is not None:
        return np.asarray(amplitudes >= options.least_dn)
    reference, followup = options.step_dn
    least = [
        max(
            _step_at(followup, change.y_px, change.x_px),
            gain * _step_at(reference, change.reference_y_px, change.reference_x_px),
        )
        for change in changes
    ]
    return np.asarray(amplitudes >= np.array(least))


def _of_colour(change: Change, least_dn: float | None, steps_dn: Steps, gain: float) -> bool:
    amplitudes = np.abs(change.amplitude_rgb_dn or (change.amplitude_dn,) * 3)
    if least_dn is not None:
        return bool((amplitudes >= least_dn).any())
    reference, followup = (
        (0.0, 0.0, 0.0)
        if one is None
        else [_step_at(one[..., number], y, x) for number in range(3)]
        for one, y, x in zip(
            steps_dn,
            (change.reference_y_px, change.y_px),
            (change.reference_x_px, change.x_px),
            strict=True,
        )
    )
    return bool((amplitudes >= np.maximum(followup, gain * np.array(reference))).any())


def _step_at(step_dn: Float32Array | None, y_px: float, x_px: float) -> float:
    if step_dn is None:
        return 0.0
    rows, cols = step_dn.shape
    row, col = min(max(round(y_px), 0), rows - 1), min(max(round(x_px), 0), cols - 1)
    return float(step_dn[row, col])
