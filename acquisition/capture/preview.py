"""What a plan asks for, before anything is captured."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from acquisition.bench import BenchConfig
from acquisition.capture.auto_exposure import flicker_fraction, without_flicker
from acquisition.dataframe import dataframe
from acquisition.plan import CapturePlan, PlanEntry, PlanEstimate, estimate_plan, plan_entries
from acquisition.session import MANIFEST_NAME

FLICKER_LIMIT = 0.01
"""Fraction of the flicker left in a capture, above which it is worth a warning."""
if TYPE_CHECKING:
    from pandas import DataFrame


_PLANNED = ("index", "kind", "target", "orientation_deg", "height_mm", "exposure_us")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlanPreview:
    """The captures that a plan asks for, in order, and what they take."""

    entries: tuple[PlanEntry, ...]
    estimate: PlanEstimate
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        bytes_ = self.estimate.bytes_
        size = "" if bytes_ is None else f", {bytes_ / 1e6:.0f} MB"
        return (
            f"<PlanPreview: {len(self.entries)} captures, {self.estimate.placements} placements, "
            f"{self.estimate.seconds:.0f} s{size}>"
        )

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(name)}</th>" for name in _PLANNED)
        table = f"<caption>{escape(repr(self)[1:-1])}</caption><tr>{head}</tr>"
        for one in self.entries:
            cells = (escape(str(getattr(one, name))) for name in _PLANNED)
            table += f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        return f"<table>{table}</table>"

    def to_dataframe(self) -> "DataFrame":
        """Return the captures as a pandas table, a line each.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.to_json()["captures"])

    def to_json(self) -> dict[str, Any]:
        """Return the captures as ``standoff capture --dry-run --json`` prints them."""
        captures = [
            {
                **{name: getattr(entry, name) for name in _PLANNED},
                "bracket": None if entry.bracket is None else entry.bracket.model_dump(),
            }
            for entry in self.entries
        ]
        return {
            "captures": captures,
            "placements": self.estimate.placements,
            "seconds": round(self.estimate.seconds, 1),
            "bytes": self.estimate.bytes_,
        }

    @classmethod
    def of(cls, plan: CapturePlan, bench: BenchConfig, out: Path | None = None) -> Self:
        """Look ahead at a plan on a bench; a session that ``out`` holds already is noted.

        Raises
        ------
        PlanError
            If the plan names no capture.
        """
        entries = plan_entries(plan)
        notes = [*flicker_warnings(plan, entries, bench)]
        if out is not None and (out / MANIFEST_NAME).is_file():
            notes.append(
                f"{out} already holds a session: with the same bench and plan it resumes where it "
                "stopped; with others it is refused"
            )
        return cls(
            entries=entries,
            estimate=estimate_plan(plan, entries, bench, bench.frame_shape),
            notes=tuple(notes),
        )


def flicker_warnings(
    plan: CapturePlan, entries: Sequence[PlanEntry], bench: BenchConfig
) -> Iterator[str]:
    """Warn of exposures that are not a multiple of the light's period, on a real bench."""
    mains_hz = bench.capture.mains_hz
    if bench.camera.driver == "simulated":
        return
    found_later = plan.auto_exposure
    asked_us = {
        # Longer exposures of a bracket are shortened to whole periods.
        entry.exposure_us or bench.camera.exposure_us
        for entry in entries
        if entry.kind != "dark" and (entry.exposure_us is not None or not found_later)
    }
    for exposure_us in sorted(asked_us):
        left = flicker_fraction(exposure_us, mains_hz)
        if left > FLICKER_LIMIT:
            better_us = max(without_flicker(exposure_us, mains_hz), 0.5e6 / mains_hz)
            yield (
                f"an exposure of {exposure_us:g} us is not a multiple of the "
                f"{0.5e3 / mains_hz:.3g} ms flicker period of lamps on {mains_hz} Hz mains, "
                f"and leaves {100 * left:.0f} % of the flicker; use {better_us:.0f} us, "
                "or capture.mains_hz = 0 for steady light"
            )
