"""What the pose card shows, as a plain JSON object: the verdict, the reference, what judges."""

from typing import Any

from acquisition.printable import on_one_line
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import PoseView
from standoff.console.pose_curves import CurveView
from standoff.console.web.figure_ages import Validity

Document = dict[str, Any]

_NO_PICTURE = "waiting for a picture"


def pose_state(hub: BenchHub, validity: Validity) -> Document:
    """The pose, its reference as a picture over the live one, and what judges it."""
    view, latest, curves = hub.pose.view, hub.frames.latest, hub.curves.view
    shown = None if latest is None else latest.image_dn.shape
    document = pose_document(view, validity)
    if view.picture is not None and not view.is_possible:
        document["reason"] = "choose a curve" if curves.file else "no curve judges poses"
    return document | {"overlay": overlay_document(view, shown), "curve": curve_document(curves)}


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
        waits = "searching the picture for the reference" if view.is_searching else _NO_PICTURE
        return document | {"verdict": "…", "reason": waits}
    margin = "" if verdict.margin is None else f"{100 * verdict.margin:+.0f} %"
    return document | {
        "verdict": verdict.verdict.upper(),
        "reason": verdict.reason,
        "margin": margin,
        "probability": "" if verdict.probability is None else f"{100 * verdict.probability:.0f} %",
    }


def overlay_document(view: PoseView, shown: tuple[int, ...] | None) -> Document:
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
            "it cannot lie over it."
        )
    return {"number": view.picture.number, "fault": fault}


def curve_document(view: CurveView) -> Document:
    """The file, the curve in words and the threshold; the lists are fetched at a new revision."""
    return {
        "revision": view.revision,
        "file": on_one_line(view.file),
        "name": view.name,
        "chosen": view.chosen,
        "min_dprime": view.min_dprime,
    }
