"""How old the figures on a page are: what is old is shown as old, and what is very old not at all.

The page adds the time since it last heard of the console, and so knows the age without it, too.
"""

import time
from dataclasses import dataclass
from typing import Literal

from standoff.console.bench_hub import BenchHub

STALE_S, STALE_FRAMES = 0.5, 3
"""A figure is stale once it is older than both."""

NOTHING_S, NOTHING_STALE = 3.0, 2
"""A figure is not shown once it is older than this, and than so many times what makes it stale."""

Validity = Literal["valid", "stale", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureAge:
    """Age of a figure, and the ages from which on it is stale, and nothing; None is no figure."""

    age_s: float | None
    stale_s: float = STALE_S
    nothing_s: float = NOTHING_S

    @property
    def validity(self) -> Validity:
        """Whether it may be shown as it is, as stale, or not at all."""
        if self.age_s is None or self.age_s > self.nothing_s:
            return "none"
        return "stale" if self.age_s > self.stale_s else "valid"

    def document(self) -> dict[str, float | None]:
        """In seconds, for a page."""
        return {
            "age_s": None if self.age_s is None else round(self.age_s, 3),
            "stale_s": round(self.stale_s, 3),
            "nothing_s": round(self.nothing_s, 3),
        }


def figure_age(measured_s: float | None, now_s: float, *, period_s: float = 0.0) -> FigureAge:
    """Age of a figure that is expected anew every ``period_s``.

    Parameters
    ----------
    measured_s
        When what it was made of arrived (monotonic); None if there is no figure.
    now_s
        Monotonic time.
    period_s
        Of long exposures, three of which may pass before a figure of the last one is stale.
    """
    stale_s = max(STALE_S, STALE_FRAMES * period_s)
    return FigureAge(
        age_s=None if measured_s is None else max(now_s - measured_s, 0.0),
        stale_s=stale_s,
        nothing_s=max(NOTHING_S, NOTHING_STALE * stale_s if stale_s > STALE_S else 0.0),
    )


def figure_ages(hub: BenchHub) -> dict[str, FigureAge]:
    """Ages of all figures of a bench, by the names that its page gives them."""
    now_s, latest, settings = time.monotonic(), hub.frames.latest, hub.camera.settings
    exposure_s = 0.0 if settings is None else 1e-6 * settings.exposure_us
    period_s = max(hub.frames.period_s, exposure_s)
    facts = hub.picture.facts
    of_frames = {
        "camera": None if latest is None else latest.arrived_s,
        "focus": facts.focus_s,
        "levels": facts.levels_s,
        "edge": hub.sharpness.view.arrived_s,
        "square": hub.squareness.view.arrived_s,
        "pose": hub.pose.view.arrived_s,
    }
    ages = {
        name: figure_age(measured_s, now_s, period_s=period_s)
        for name, measured_s in of_frames.items()
    }
    stage = hub.stage.view
    read_s = stage.read_s if stage.status.is_ready else None  # a lost one has no height
    return ages | {"stage": figure_age(read_s, now_s)}
