"""What the pages show, as plain JSON objects: rounded figures, units, states in words."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import quote

from acquisition.devices import CameraSettings, StreamStatistics
from acquisition.focus import Region
from acquisition.plan import CapturePlan, PlanEntry, PlanEstimate
from acquisition.printable import on_one_line
from acquisition.session import SPARE_BYTES
from calibration.estimate import NORMAL_95
from calibration.geometry import Levelling
from standoff.console.bench_hub import BenchHub, ConsoleHub
from standoff.console.camera_service import Exposing
from standoff.console.control_arbiter import ControlView
from standoff.console.devices import DeviceStatus
from standoff.console.edge_reading import EdgeReading
from standoff.console.focus_sweep import SweepView
from standoff.console.frames import FrameCounts
from standoff.console.jobs import Prompt
from standoff.console.monitors import Levels, PictureFacts, PoseView, SharpnessView, SquarenessView
from standoff.console.page_words import page_words
from standoff.console.result_jobs import ResultProgress
from standoff.console.session_run import PlanRow, RunView
from standoff.console.stage_service import StageView
from standoff.terminal import time_text

STALE_S, STALE_FRAMES = 0.5, 3
"""A figure is stale once it is older than both."""

NOTHING_S, NOTHING_STALE = 3.0, 2
"""A figure is not shown once it is older than this, and than so many times what makes it stale."""

SCARCE_BYTES, TOO_FEW_BYTES = 2 * 10**9, 10**8
CLIPPED_FRACTION = 1e-3

STAGE_WORDS = {
    "idle": "at rest",
    "moving": "moving",
    "homing": "homing",
    "hold": "held",
    "door": "door open",
    "alarm": "ALARM",
    "unknown": "unknown",
}

SIDES = "sides as in the picture"
NO_PICTURE = "waiting for a picture"

Document = dict[str, Any]
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

    Times are monotonic. Of long exposures, three may pass before a figure of the last one is stale.
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


def _pose_state(hub: BenchHub, validity: Validity) -> Document:
    """The pose, its reference as a picture over the live one, and what judges it."""
    view, latest, curves = hub.pose.view, hub.frames.latest, hub.curves.view
    shown = None if latest is None else latest.image_dn.shape
    document = pose_document(view, validity)
    if view.picture is not None and not view.is_possible:
        document["reason"] = "choose a curve" if curves.file else "no curve judges poses"
    curve = {  # the lists are fetched at a new revision
        "revision": curves.revision,
        "file": on_one_line(curves.file),
        "name": curves.name,
        "chosen": curves.chosen,
        "min_dprime": curves.min_dprime,
    }
    return document | {"overlay": _overlay_document(view, shown), "curve": curve}


def pose_document(view: PoseView, validity: Validity = "valid") -> Document:
    """Go, no go or unsure, with the reason, the margin and the probability, unless too old."""
    document: Document = {
        "is_possible": view.is_possible,
        "reference": on_one_line(view.reference),
        "verdict": "",
        "reason": on_one_line(view.fault),
        "margin": "",
        "probability": "",
    }
    verdict = view.verdict
    if view.picture is None or not view.is_possible or view.fault:
        return document
    # A pose that was lost is searched for again and again, and meanwhile is no less lost.
    is_out_of_date = view.is_searching and verdict is not None and verdict.dprime is not None
    if verdict is None or validity == "none" or is_out_of_date:
        waits = "searching the picture for the reference" if view.is_searching else NO_PICTURE
        return document | {"verdict": "…", "reason": waits}
    margin = "" if verdict.margin is None else f"{100 * verdict.margin:+.0f} %"
    return document | {
        "verdict": verdict.verdict.upper(),
        "reason": verdict.reason,
        "margin": margin,
        "probability": "" if verdict.probability is None else f"{100 * verdict.probability:.0f} %",
    }


def _overlay_document(view: PoseView, shown: tuple[int, ...] | None) -> Document:
    """The number of the reference, None without one, and why it cannot lie over the picture.

    ``shown`` are rows and columns of the live picture, None before the first.
    """
    if view.picture is None:
        return {"number": None, "fault": ""}
    rows, cols = view.picture.shape
    fault = ""
    if shown is not None and tuple(shown) != (rows, cols):
        fault = (
            f"The reference has {cols} × {rows} pixels, the live picture {shown[1]} × {shown[0]}: "
            "it cannot be overlaid."
        )
    return {"number": view.picture.number, "fault": fault}


def measure_document(view: SharpnessView, square: SquarenessView, *, has_field: bool) -> Document:
    """The edge under the region, the four regions and the squareness."""
    return {
        "type": "measure",
        "rate": f"{view.rate_hz:.1f}",
        "edge": None if view.edge is None else _edge(view.edge),
        "why_not": view.why_not,
        "is_awaited": view.is_awaited,
        "has_field": has_field,
        "field": [
            {
                "name": each.name,
                "region": _box(each.region),
                "percent": f"{each.percent_of_peak:.1f}" if each.has_detail else "–",
                "why_not": "" if each.has_detail else "no edge",
                "sigma": "–" if each.edge is None else f"{each.edge.sigma_px:.3f}",
            }
            for each in view.field
        ],
        "square": {
            "is_wanted": square.is_wanted,
            "why_not": square.why_not,
            **_levelling(square.levelling),
        },
    }


def sweep_document(view: SweepView) -> Document:
    """The focus sweep: its points, its curve and what was found."""
    peak = view.peak
    return {
        "type": "sweep",
        "state": view.state,
        "message": view.message,
        "progress": f"{view.taken} of {view.planned}" if view.state == "running" else "",
        "points": [
            [_short(point.height_mm), _short(point.value), _short(point.err)]
            for point in view.points
        ],
        "curve": [[_short(height), _short(value)] for height, value in view.curve()],
        "peak_mm": None if peak is None else round(peak.height_mm, 3),
        "peak_err_mm": None if peak is None else _short(peak.err_mm),
        **_levelling(view.levelling),
        "advice": view.advice,
    }


def _edge(edge: EdgeReading) -> Document:
    lp_per_mm, lp_err = edge.mtf50_lp_per_mm, edge.mtf50_err_cy_per_px
    if lp_per_mm is not None and lp_err is not None:
        lp_err *= lp_per_mm / edge.mtf50_cy_per_px
    return {
        "sigma": _with_error(edge.sigma_px, edge.sigma_err_px),
        "mtf50": _with_error(edge.mtf50_cy_per_px, edge.mtf50_err_cy_per_px),
        "mtf50_lp": "–" if lp_per_mm is None else _with_error(lp_per_mm, lp_err),
        "angle": f"{edge.angle_deg:.1f}",
        "edges": edge.edges,
        "remarks": ", ".join(flag.replace("_", " ") for flag in edge.flags),
        "distance": [_short(value) for value in edge.distance_px.tolist()],
        "levels": [_short(value) for value in edge.levels.tolist()],
    }


def _levelling(found: Levelling | None) -> Document:
    if found is None:
        return {"advice": "", "tilt": ""}
    right = _with_error(found.right_deg, found.right_err_deg)
    down = _with_error(found.down_deg, found.down_err_deg)
    return {
        "advice": found.advice if found.advice == "level" else f"{found.advice} ({SIDES})",
        "tilt": f"left to right {right}°, top to bottom {down}°",
    }


def _with_error(value: float, err: float | None) -> str:
    """A value with half its 95 % interval, to two digits of that: ``0.5831 ± 0.0027``."""
    if err is None or not math.isfinite(err) or err <= 0:
        return f"{value:.4g}"
    half = NORMAL_95 * err
    digits = max(0, 1 - math.floor(math.log10(half)))
    return f"{value:.{digits}f} ± {half:.{digits}f}"


def _box(region: Region) -> list[int]:
    return [region.x_px, region.y_px, region.width_px, region.height_px]


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def state_document(hub: ConsoleHub) -> Document:
    """Everything that changes from moment to moment, the same for every page."""
    job = hub.jobs.current
    return {
        "result": _result_document(hub.results.view),
        "job": None if job is None else {"name": job.name, "is_stopping": job.is_stopping},
        "is_compiling": hub.compiling.is_compiling,
        "disk": disk_document(hub.free_bytes()),
        "arrivals": hub.photographs.revision,
        "notices": [
            {"number": notice.number, "text": _said(notice.text)} for notice in hub.notices
        ],
        "pose": {"is_possible": hub.results.has_curves},
        "prompt": None,
        **(_bench_document(hub) if isinstance(hub, BenchHub) else {}),
    }


def _bench_document(hub: BenchHub) -> Document:
    """What only a console with a bench has."""
    ages, stop = figure_ages(hub), hub.stopping.view
    return {
        "ages": {name: age.document() for name, age in ages.items()},
        "camera": camera_document(
            hub.camera.status,
            hub.camera.settings,
            hub.frames.counts,
            hub.camera.statistics,
            warnings=hub.camera.warnings,
            validity=ages["camera"].validity,
        )
        | {
            "name": "" if hub.camera.info is None else hub.camera.info.model,
            "exposing": _exposing_document(hub.camera.exposing),
        },
        "stage": stage_document(hub.stage.view, ages["stage"].validity),
        "focus": focus_document(hub.picture.facts, ages["focus"].validity),
        "run": run_document(hub.run.view, is_pause_wanted=hub.run.is_pause_wanted),
        "stop": {"number": stop.number, "outcome": stop.outcome, "fault": _said(stop.fault)},
        "prompt": _prompt_document(hub.prompts.current),
        "pose": _pose_state(hub, ages["pose"].validity),
        "exposure_limits_us": list(hub.camera.exposure_limits_us),
        "snapshot": hub.snapshots.latest,
    }


def target_text(kind: str, target: str) -> str:
    """What lies under the camera, said once where its name is its kind."""
    return target if target == kind else f"{kind} {target}"


def control_document(view: ControlView) -> Document:
    """Who is in control, as one page sees it."""
    if view.is_mine:
        text = "You are in control as"
    elif view.is_asking:
        text = f"Asking {view.holder} for control"
    elif not view.holder:
        text = "Nobody is in control"
    else:
        text = f"{view.holder} is in control{', but not connected' if view.is_away else ''}"
    return {
        "is_mine": view.is_mine,
        "text": text,
        "holder": view.holder,
        "viewers": view.viewers,
        "asked_by": view.asked_by,
        "is_asking": view.is_asking,
        "may_take": view.may_take,
    }


def camera_document(
    status: DeviceStatus,
    settings: CameraSettings | None,
    counts: FrameCounts,
    statistics: StreamStatistics | None,
    *,
    warnings: Sequence[str] = (),
    validity: Validity = "valid",
) -> Document:
    """The camera's state, settings and frame statistics; ``validity`` is that of its frames."""
    return {
        **_status(status),
        "exposure_us": None if settings is None else round(settings.exposure_us, 1),
        "gain_db": (
            None if settings is None or settings.gain_db is None else round(settings.gain_db, 2)
        ),
        "format": (
            ""
            if settings is None
            else f"{settings.width_px} × {settings.height_px} {settings.pixel_format}"
        ),
        "validity": validity,
        "rate": "–" if validity == "none" else f"{counts.rate_hz:.1f}",
        "complete": counts.complete,
        "incomplete": counts.incomplete,
        "lost": counts.lost,
        "resent": None if statistics is None else statistics.resent_packets,
        "warnings": list(warnings),
    }


def _exposing_document(exposing: Exposing | None) -> Document | None:
    """The long exposure that is waited for."""
    if exposing is None:
        return None
    return {
        "seconds": round(exposing.seconds, 1),
        "left": math.ceil(exposing.left_s),
        "is_dropped": exposing.is_dropped,
    }


def stage_document(view: StageView, validity: Validity = "valid") -> Document:
    """The stage's state in words, its height and its limits; a height too old is not shown."""
    is_ready = view.status.is_ready
    is_known = view.height_mm is not None and validity != "none"
    height = f"{view.height_mm:.3f}" if is_known else "–"
    low_mm, high_mm = view.limits_mm
    return {
        **_status(view.status),
        "name": "" if view.info is None else view.info.model,
        "motion": view.state,
        "motion_text": STAGE_WORDS[view.state] if is_ready else "not connected",
        "height": height,
        "height_mm": view.height_mm,
        "target": _target(view),
        "is_homed": view.is_homed,
        "homed_text": "homed" if view.is_homed else "not homed",
        "limits_mm": [low_mm, high_mm],
        "limits": f"{low_mm:g} to {high_mm:g} mm",
        "warnings": list(view.warnings),
    }


def _target(view: StageView) -> str:
    """Where it is going; in an alarm, or before it is homed, what to do."""
    if view.state == "alarm" and view.status.is_ready:
        return "locked until it is homed: press Home; if it refuses, Clear alarm first"
    if view.state == "idle" and view.status.is_ready and not view.is_homed:
        return "press Home: it does not know its height"
    return "" if view.target_mm is None else f"moving to {view.target_mm:.3f} mm"


def focus_document(facts: PictureFacts, validity: Validity = "valid") -> Document:
    """The focus figures, and a hint in words; figures too old are not shown."""
    document: Document = {
        "metric": facts.measure,
        "region": None if facts.region is None else _box(facts.region),
        "value": "–",
        "peak": "–",
        "percent": None,
        "percent_text": "–",
        "trend": "steady",
        "hint": "waiting for pictures",
        "is_past_peak": False,
    }
    reading = facts.focus
    if reading is None:
        return document
    if validity == "none":
        return document | {"hint": "no new picture"}
    if not reading.has_detail:
        return document | {"hint": "nothing to focus on"}
    if reading.is_past_peak:
        hint = "past the peak: go back"
    elif reading.trend == "steady":
        hint = "steady"
    else:
        hint = "getting sharper" if reading.trend == "rising" else "getting softer"
    return document | {
        "value": f"{reading.value:.4g}",
        "peak": f"{reading.peak:.4g}",
        "percent": round(reading.percent_of_peak, 2),
        "percent_text": f"{reading.percent_of_peak:.1f}",
        "trend": reading.trend,
        "hint": hint,
        "is_past_peak": reading.is_past_peak,
    }


def levels_document(facts: PictureFacts) -> Document | None:
    """Histogram and focus trace, which are sent less often; None before the first picture."""
    levels = facts.levels
    if levels is None:
        return None
    return {
        "type": "levels",
        "counts": [int(count) for count in levels.counts],
        "max_level_dn": levels.max_level_dn,
        "mean": f"{levels.mean_dn:.0f}",
        "saturated": saturation_text(levels),
        "is_saturated": levels.saturated_fraction > CLIPPED_FRACTION,
        "trace": [float(f"{value:.5g}") for value in facts.trace],
        "trace_s": [round(each_s, 2) for each_s in facts.trace_s],
    }


def saturation_text(levels: Levels) -> str:
    """Share of the picture that is saturated: ``none``, ``< 0.01 %``, ``1.2 %``."""
    percent = 100.0 * levels.saturated_fraction
    if percent == 0:
        return "none"
    return "< 0.01 %" if percent < 0.01 else f"{percent:.2f} %"


def run_document(view: RunView, *, is_pause_wanted: bool) -> Document:
    """Progress of the session; its table is a separate document."""
    left = view.seconds_left
    return {
        "session": view.session,
        "plan": view.plan,
        "state": view.state,
        "message": _said(view.message),
        "placed": on_one_line(view.placed),
        "captured": view.captured,
        "planned": len(view.rows),
        "left": "" if left is None else f"{time_text(left)} left",
        "is_pause_wanted": is_pause_wanted,
        "revision": view.revision,
    }


def plan_document(view: RunView) -> Document:
    """The plan as a table: done, next, failed, pending."""
    return {
        "type": "plan",
        "revision": view.revision,
        "session": view.session,
        "rows": [_row(row) for row in view.rows],
    }


def preview_document(
    name: str,
    plan: CapturePlan,
    entries: Sequence[PlanEntry],
    estimate: PlanEstimate,
    warnings: Sequence[str],
    *,
    free_bytes: int,
) -> Document:
    """What a plan will take, before it runs."""
    disk = "depends on the frame" if estimate.bytes_ is None else f"{estimate.bytes_ / 1e6:.0f} MB"
    return {
        "type": "preview",
        "name": name,
        "plan": plan.name,
        "captures": estimate.captures,
        "placements": estimate.placements,
        "time": time_text(estimate.seconds),
        "disk": disk,
        "is_room": estimate.bytes_ is None or free_bytes >= estimate.bytes_ + SPARE_BYTES,
        "room": f"{free_bytes / 1e6:.0f} MB free, of which {SPARE_BYTES / 1e6:.0f} MB stay free",
        "warnings": list(warnings),
        "rows": [_row(PlanRow(entry=entry)) for entry in entries],
    }


def _result_document(view: ResultProgress) -> Document:
    """The result that is being computed, or how the last one ended."""
    progress = view.progress
    return {
        "number": view.number,
        "session": view.session,
        "kind": view.kind,
        "seconds": round(time.monotonic() - view.begun_s) if view.state == "running" else 0,
        "title": on_one_line(view.title),
        "state": view.state,
        "is_alarming": view.is_alarming,
        "text": on_one_line(progress.text),
        "done": progress.done,
        "total": progress.total,
        "message": _said(view.message),
        "page": f"/sessions/{quote(view.session)}/results/{quote(view.page)}" if view.page else "",
    }


def _prompt_document(prompt: Prompt | None) -> Document | None:
    """The question that is waiting, with its buttons."""
    if prompt is None:
        return None
    return {
        "number": prompt.number,
        "text": on_one_line(prompt.text),
        "wants_text": prompt.wants_text,
        "choices": [{"key": key, "label": label} for key, label in prompt.choices.items()],
    }


def disk_document(free_bytes: int) -> Document:
    """Free space on the disk, and whether it is low."""
    level = "ok"
    if free_bytes < SCARCE_BYTES:
        level = "fail" if free_bytes < TOO_FEW_BYTES else "warn"
    return {"text": f"{free_bytes / 1e9:.1f} GB free", "level": level}


def _status(status: DeviceStatus) -> Document:
    return {
        "state": status.state,
        "text": _said(status.text),
        "remedy": _said(status.remedy),
    }


def _said(text: str) -> str:
    return on_one_line(page_words(text))


def _row(row: PlanRow) -> Document:
    entry = row.entry
    return {
        "index": entry.index,
        "what": on_one_line(target_text(entry.kind, entry.target)),
        "orientation": f"{entry.orientation_deg:g}",
        "height": f"{entry.height_mm:g}" if row.height_mm is None else f"{row.height_mm:.3f}",
        "exposure": "" if entry.exposure_us is None else f"{entry.exposure_us:g}",
        "focus": "" if row.focus_value is None else f"{row.focus_value:.3g}",
        "state": row.state,
        "note": on_one_line(row.note),
    }
