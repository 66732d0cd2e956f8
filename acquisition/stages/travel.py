"""What every height stage has in common: limits, the side of approach, time limits."""

from math import isfinite

from acquisition.bench import StageConfig
from acquisition.devices import HomingStage, Stage
from acquisition.errors import StageLimitError
from acquisition.quantities import slip_between


def refuse_beyond_limits(height_mm: float, limits_mm: tuple[float, float]) -> None:
    """Raise if a height is outside the travel of a stage.

    Raises
    ------
    StageLimitError
        If it is not a number or outside the limits.
    """
    low_mm, high_mm = limits_mm
    if not (isfinite(height_mm) and low_mm <= height_mm <= high_mm):
        raise StageLimitError(
            f"the stage travels from {low_mm:g} to {high_mm:g} mm, not to {height_mm:g} mm; "
            f"nothing moved{slip_between(height_mm, 'mm', low_mm, high_mm)}",
            height_mm=height_mm,
            limits_mm=limits_mm,
        )


def approach_heights_mm(
    config: StageConfig, *, start_mm: float, target_mm: float, is_flank_taken: bool
) -> list[float]:
    """Heights to visit in turn, so that the target is approached from the configured side.

    Parameters
    ----------
    config
        Side, play and limits.
    start_mm, target_mm
        Where the stage is and where it is to go.
    is_flank_taken
        Whether the last move already came from the configured side.

    Returns
    -------
    list of float
        One or two heights; a target right at a limit may have no room before it.
    """
    side = 1.0 if config.approach == "from_below" else -1.0
    needed_mm = 0.0 if is_flank_taken else config.backlash_mm
    if side * (target_mm - start_mm) >= needed_mm:
        return [target_mm]
    low_mm, high_mm = config.limits_mm
    before_mm = min(max(target_mm - side * config.backlash_mm, low_mm), high_mm)
    return [target_mm] if before_mm == target_mm else [before_mm, target_mm]


def move_timeout_s(config: StageConfig) -> float:
    """Twice the whole travel at the feed, for ramps and backlash moves, and the settling."""
    travel_mm = config.limits_mm[1] - config.limits_mm[0]
    return 10.0 + config.settle_s + 2.0 * 60.0 * travel_mm / config.feed_mm_per_min


def home_timeout_s(config: StageConfig, stage: Stage) -> float:
    """Time for homing: the whole travel once, and the switch twice, slowly.

    A controller homes by a travel and rates of its own, which may be longer and slower than those
    of the bench file; one that states them is given a quarter more.
    """
    stated_s = stage.homing_s if isinstance(stage, HomingStage) else 0.0
    return 30.0 + max(move_timeout_s(config), 1.25 * stated_s)
