"""The limit that curves of d' predict for a comparison."""

from os import PathLike, fspath
from pathlib import Path

from analysis.changes import ChangeSummary, LimitCurve
from analysis.detectability import (
    DetectabilityCurve,
    DetectabilityCurves,
    expected_limits,
    read_curves,
)
from simulation.arguments import ArgumentTypeError, kind_of
from standoff.errors import ArgumentError
from standoff.library.call import Call
from standoff.library.comparison.limit_options import DetectionLimitOptions


def expected_limit(options: DetectionLimitOptions) -> LimitCurve | None:
    """Return what the curves of observer ``changes`` predict; None if there are no curves.

    Raises
    ------
    TypeError
        If they are neither curves nor a path.
    ArgumentError
        If none of the curves is meant, or several.
    ResultsFileError
        If the file cannot be read.
    """
    if options.curves is None:
        return None
    curves, name = options.curves, "curves"
    if isinstance(curves, str | PathLike):
        name, curves = fspath(curves), read_curves(Path(curves))
    if isinstance(curves, DetectabilityCurve):
        curves = DetectabilityCurves(curves=[curves])
    if not isinstance(curves, DetectabilityCurves):
        raise ArgumentTypeError(
            f"expected curves of d' or the path of a curves.json, got {kind_of(curves)}",
            argument="curves",
        )
    return expected_limits(_chosen(curves, options, name))


def note_on_prediction(
    call: Call, options: DetectionLimitOptions | None, found: ChangeSummary
) -> None:
    """Say so where the curves predict nothing for the pair's zoom."""
    limit = found.detection_limit
    asked = options is not None and options.curves is not None
    if asked and limit is not None and limit.predicted is None:
        call.note(
            f"the curves say nothing of zoom {found.zoom:.3f}; no limit was predicted for this pair"
        )


def _chosen(
    curves: DetectabilityCurves, options: DetectionLimitOptions, name: str
) -> DetectabilityCurve:
    """The one that predicts comparisons; the limit does not depend on the curve's contrast."""
    fitting = {
        (curve.model, curve.noise_dn): curve
        for curve in curves.curves
        if curve.observer == "changes"
        and curve.seen_sigma_px is not None
        and options.curve_model in (None, curve.model)
        and (options.curve_noise_dn is None or _is_same(options.curve_noise_dn, curve.noise_dn))
    }
    if len(fitting) == 1:
        return next(iter(fitting.values()))
    if not fitting:
        raise ArgumentError(
            f"{name}: no such curve of observer changes; make one with standoff detectability "
            "--observer changes, for a Gaussian change"
        )
    models, noises = (sorted({key[k] for key in fitting}, key=str) for k in (0, 1))
    told = [
        f"{option} ({', '.join(f'{value}' for value in values)})"
        for option, values in (("--curve-model", models), ("--curve-noise", noises))
        if len(values) > 1
    ]
    raise ArgumentError(
        f"{name}: {len(fitting)} curves of observer changes; choose by {' and '.join(told)}"
    )


def _is_same(one: float, other: float) -> bool:
    return abs(one - other) <= 1e-6 * max(abs(other), 1.0)
