"""Focus sweeps as jobs of the console, over the simulated bench."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from acquisition.choices import FEWEST_POSITIONS
from acquisition.errors import StageLimitError
from acquisition.focus import FocusOptions
from standoff.console.bench_hub import BenchHub
from standoff.console.focus_sweep import SweepPlan
from standoff.console.web._view_model import sweep_document
from standoff.errors import ApplicationError
from tests.standoff.console.hub_fixtures import idle_hub, running_hub, wait_for

FOCUS_MM = 300.0


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[BenchHub]:
    with running_hub(
        tmp_path,
        simulated__focus_distance_mm=FOCUS_MM,
        simulated__f_number=1.0,
        camera__frame_rate_hz=200.0,
        camera__exposure_us=4000.0,
    ) as made:
        made.stage.lent(lambda: None).home(60)
        yield made


def plan_of(**keys: object) -> SweepPlan:
    values: dict[str, object] = {
        "heights_mm": (250.0, 350.0),
        "steps": 11,
        "options": FocusOptions(),
        "has_field": False,
        "ends_at_peak": False,
    }
    return SweepPlan(**{**values, **keys})  # type: ignore[arg-type]


def sweep(hub: BenchHub, plan: SweepPlan) -> None:
    hub.sweep.prepare(plan)
    job = hub.jobs.begin("focus sweep", lambda job: hub.sweep.work(job, plan))
    wait_for(job.ended.is_set, "the sweep ends")


@pytest.mark.slow
def test_a_sweep_finds_the_focus_and_goes_there(hub: BenchHub) -> None:
    sweep(hub, plan_of(ends_at_peak=True))
    view = hub.sweep.view
    assert (view.state, view.taken, len(view.points)) == ("done", 11, 11), view.message
    assert view.peak is not None
    # The pupil is above the reference of the heights.
    assert hub.bench.simulated is not None
    focus_mm = FOCUS_MM - hub.bench.simulated.pupil_offset_mm
    assert view.peak.height_mm == pytest.approx(focus_mm, abs=4 * view.peak.err_mm)
    assert view.peak.err_mm < 2
    assert hub.stage.lent(lambda: None).position_mm() == pytest.approx(
        view.peak.height_mm, abs=0.01
    )
    shown = sweep_document(view)
    assert shown["peak_mm"] == pytest.approx(view.peak.height_mm, abs=0.001)
    assert len(shown["curve"]) > 20
    assert [height for height, *_ in shown["points"]] == pytest.approx(
        [250.0 + 10 * number for number in range(11)], abs=0.01
    )


@pytest.mark.slow
def test_points_of_the_second_pass_replace_those_of_the_first(hub: BenchHub) -> None:
    sweep(hub, plan_of(heights_mm=None, steps=FEWEST_POSITIONS))
    view = hub.sweep.view
    assert view.taken == view.planned == 2 * FEWEST_POSITIONS
    assert len(view.points) == FEWEST_POSITIONS


@pytest.mark.slow
def test_a_stopped_sweep_says_so_and_moves_no_further(hub: BenchHub) -> None:
    plan = plan_of(heights_mm=(200.0, 400.0), steps=100)
    hub.sweep.prepare(plan)
    job = hub.jobs.begin("focus sweep", lambda job: hub.sweep.work(job, plan))
    wait_for(lambda: hub.sweep.view.taken > 2, "some heights")
    hub.stop()
    wait_for(job.ended.is_set, "the sweep ends")
    assert hub.sweep.view.state == "stopped"
    assert hub.sweep.view.taken < 100


@pytest.mark.parametrize(
    ("keys", "error"),
    [
        ({"steps": FEWEST_POSITIONS - 1}, ApplicationError),
        ({"heights_mm": (310.0, 290.0)}, ApplicationError),
        ({"heights_mm": (290.0, 1e6)}, StageLimitError),
    ],
)
def test_a_sweep_that_cannot_be_made_is_refused_before_anything_moves(
    tmp_path: Path, keys: dict[str, object], error: type[Exception]
) -> None:
    hub = idle_hub(tmp_path)
    with pytest.raises(error):
        hub.sweep.prepare(plan_of(**keys))
    assert hub.sweep.view.state == "idle"
