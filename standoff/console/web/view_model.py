"""What the pages show, as plain JSON objects: rounded figures, units, states in words."""

import math
import time
from collections.abc import Sequence
from typing import Any

from acquisition.devices import CameraSettings, StreamStatistics
from acquisition.plan import CapturePlan, PlanEntry, PlanEstimate
from acquisition.printable import on_one_line
from acquisition.session import SPARE_BYTES
from standoff.console.bench_hub import BenchHub, Notice
from standoff.console.devices import (
    DeviceStatus,
    Exposing,
    FrameCounts,
    Levels,
    PictureFacts,
    StageView,
)
from standoff.console.jobs import ControlView, PlanRow, Prompt, RunView, StopView
from standoff.console.page_words import page_words
from standoff.console.results import ResultProgress
from standoff.console.web.figure_ages import Validity, figure_ages
from standoff.console.web.pose import pose_state
from standoff.terminal import time_text

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

Document = dict[str, Any]


def state_document(hub: BenchHub) -> Document:
    """Everything that changes from moment to moment, the same for every page."""
    job = hub.jobs.current
    ages = figure_ages(hub)
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
            "exposing": exposing_document(hub.camera.exposing),
        },
        "stage": stage_document(hub.stage.view, ages["stage"].validity),
        "focus": focus_document(hub.picture.facts, ages["focus"].validity),
        "result": result_document(hub.results.view),
        "run": run_document(hub.run.view, is_pause_wanted=hub.run.is_pause_wanted),
        "job": None if job is None else {"name": job.name, "is_stopping": job.is_stopping},
        "stop": stop_document(hub.stopping.view),
        "prompt": prompt_document(hub.prompts.current),
        "pose": pose_state(hub, ages["pose"].validity),
        "exposure_limits_us": list(hub.camera.exposure_limits_us),
        "snapshot": hub.snapshots.latest,
        "is_compiling": hub.compiling.is_compiling,
        "disk": disk_document(hub.free_bytes()),
        "notices": [_notice(notice) for notice in hub.notices],
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
        "format": "" if settings is None else _format(settings),
        "validity": validity,
        "rate": "–" if validity == "none" else f"{counts.rate_hz:.1f}",
        "complete": counts.complete,
        "incomplete": counts.incomplete,
        "lost": counts.lost,
        "resent": None if statistics is None else statistics.resent_packets,
        "warnings": list(warnings),
    }


def exposing_document(exposing: Exposing | None) -> Document | None:
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


def stop_document(view: StopView) -> Document:
    """What became of the last STOP."""
    return {"number": view.number, "outcome": view.outcome, "fault": _said(view.fault)}


def focus_document(facts: PictureFacts, validity: Validity = "valid") -> Document:
    """The focus figures, and a hint in words; figures too old are not shown."""
    region = facts.region
    document: Document = {
        "metric": facts.measure,
        "region": None
        if region is None
        else [region.x_px, region.y_px, region.width_px, region.height_px],
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


def result_document(view: ResultProgress) -> Document:
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
    }


def prompt_document(prompt: Prompt | None) -> Document | None:
    """The question that is waiting, with its buttons."""
    if prompt is None:
        return None
    return {
        "number": prompt.number,
        "text": on_one_line(prompt.text),
        "wants_text": prompt.wants_text,
        "choices": [{"key": each.key, "label": each.label} for each in prompt.choices],
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


def _format(settings: CameraSettings) -> str:
    return f"{settings.width_px} × {settings.height_px} {settings.pixel_format}"


def _notice(notice: Notice) -> Document:
    return {"number": notice.number, "text": _said(notice.text)}


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
