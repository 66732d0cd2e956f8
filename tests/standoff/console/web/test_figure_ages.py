"""When a figure is shown as it is, as stale, or not at all."""

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

pytest.importorskip("starlette", reason="the console's extra is not installed")

from acquisition.focus import Region
from standoff.console.devices import PictureFacts, StageView
from standoff.console.devices.device_status import DeviceStatus
from standoff.console.web.figure_ages import Validity, figure_age, figure_ages
from standoff.console.web.state_cache import StateCache
from standoff.console.web.view_model import focus_document, stage_document
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.hub_fixtures import idle_hub


@pytest.mark.parametrize(
    ("age_s", "period_s", "validity"),
    [
        (0.5, 0.02, "valid"),
        (0.51, 0.02, "stale"),
        (3.0, 0.02, "stale"),
        (3.01, 0.02, "none"),
        (2.9, 1.0, "valid"),  # three frames of a second
        (3.1, 1.0, "stale"),
        (6.1, 1.0, "none"),
    ],
)
def test_a_figure_is_stale_after_three_frames_or_half_a_second_and_then_nothing(
    age_s: float, period_s: float, validity: Validity
) -> None:
    assert figure_age(100.0, 100.0 + age_s, period_s=period_s).validity == validity


def test_what_was_never_measured_is_no_figure() -> None:
    age = figure_age(None, 100.0)
    assert age.validity == "none"
    assert age.document()["age_s"] is None


@given(st.floats(0, 1e6), st.floats(-10, 1e3), st.floats(0, 60))
def test_a_figure_never_becomes_valid_again_by_waiting(
    measured_s: float, passed_s: float, period_s: float
) -> None:
    order = ("valid", "stale", "none")
    now, later = (
        order.index(figure_age(measured_s, measured_s + each, period_s=period_s).validity)
        for each in (passed_s, passed_s + 1)
    )
    assert now <= later


def test_every_figure_has_the_age_of_its_own_frame(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    assert {age.age_s for age in figure_ages(hub).values()} == {None}
    cache = StateCache(hub)
    hub.frames.publish(frame(np.full((48, 64), 700, np.uint16), 1), SETTINGS)
    first = hub.frames.latest
    assert first is not None
    hub.picture.look(first)
    hub.sharpness.look_at(Region(x_px=0, y_px=0, width_px=64, height_px=48))
    hub.sharpness.look(first)
    assert cache.levels() is not None
    hub.frames.publish(frame(np.full((48, 64), 700, np.uint16), 2), SETTINGS)
    ages = figure_ages(hub)
    now_s = time.monotonic()
    for name in ("levels", "edge"):
        assert ages[name].age_s == pytest.approx(now_s - first.arrived_s, abs=0.5)
    camera_s, edge_s = ages["camera"].age_s, ages["edge"].age_s
    assert camera_s is not None
    assert edge_s is not None
    assert camera_s < edge_s  # its frame is the second
    assert ages["pose"].age_s is None


def test_a_height_or_focus_that_is_too_old_is_not_told() -> None:
    ready = DeviceStatus(state="ready")
    view = StageView(status=ready, state="idle", height_mm=250.0, is_homed=True)
    assert stage_document(view, "stale")["height"] == "250.000"
    assert stage_document(view, "none")["height"] == "–"
    assert focus_document(PictureFacts(), "none")["value"] == "–"
