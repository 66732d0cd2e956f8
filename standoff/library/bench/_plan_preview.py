"""A bench and a plan as a caller gives them, and what the plan asks for."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

from acquisition.bench import BenchConfig, load_bench
from acquisition.capture import PlanPreview
from acquisition.plan import CapturePlan, load_plan
from simulation.arguments import ArgumentTypeError, checked, kind_of

FilePath: TypeAlias = str | PathLike[str]
"""As in ``standoff.library.call``, whose import takes longer than a preview."""


@checked
def preview_plan(
    plan: CapturePlan | FilePath,
    bench: BenchConfig | FilePath,
    out: FilePath | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
) -> PlanPreview:
    """Return the captures that a plan asks for; no device is opened and no file written.

    Parameters
    ----------
    plan, bench, out, settings
        As in ``capture_session``. If ``out`` already holds a session, a note says so.

    Returns
    -------
    PlanPreview
        The captures in order, and their placements, time and disk space.

    Raises
    ------
    BenchConfigError, PlanError
        If the bench or the plan is not valid.

    Examples
    --------
    >>> preview = standoff.preview_plan("plan.toml", "bench.toml")
    >>> len(preview.entries), preview.estimate.seconds < 60
    (2, True)
    """
    config, folder = bench_config(bench, settings), None if out is None else Path(out)
    return PlanPreview.of(given_plan(plan), config, folder)


def given_plan(plan: CapturePlan | FilePath) -> CapturePlan:
    """Return a plan as given, or read from its file."""
    return plan if isinstance(plan, CapturePlan) else load_plan(Path(plan))


def bench_config(bench: object, settings: Mapping[str, Any] | None) -> BenchConfig:
    """Return a bench config, read from its file if a path is given, with ``settings`` applied."""
    if isinstance(bench, str | PathLike):
        return load_bench(Path(bench), dict(settings or {}))
    if not isinstance(bench, BenchConfig):
        raise ArgumentTypeError(
            f"expected the path of a bench file or a config, got {kind_of(bench)}", argument="bench"
        )
    if settings:
        raise ArgumentTypeError(
            "expected None, as bench is a config already, got keys; change the config instead",
            argument="settings",
        )
    return bench
