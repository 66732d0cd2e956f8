"""``standoff.Bench`` on the simulated bench, and what a script may do wrong with it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import standoff
from acquisition.errors import (
    BenchConfigError,
    DeviceDisconnectedError,
    DeviceError,
    PlanError,
    SessionError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.focus import NoFocusPeakError
from acquisition.plan import PlanEntry
from acquisition.session import verify
from hil_mocks import SimulatedBench
from hil_mocks.devices import CameraFaults
from standoff.library import height_series
from tests.hil_mocks.benches import bench_config

STEP_MM = 0.001
"""Heights are read back in steps of the simulated stage, which are finer than this."""


@pytest.fixture
def bench() -> Iterator[standoff.Bench]:
    with standoff.Bench(bench_config(), operator="Zoë") as opened:
        opened.home()
        yield opened


def simulated(bench: standoff.Bench) -> SimulatedBench:
    found = bench._open().simulated
    assert found is not None
    return found


def test_a_move_returns_the_height_read_back(bench: standoff.Bench) -> None:
    assert bench.move(123.4) == pytest.approx(123.4, abs=0.01)  # the stage's tolerance
    assert bench.height_mm == pytest.approx(simulated(bench).stage.true_height_mm, abs=STEP_MM)


def test_a_capture_is_the_mean_at_the_height_with_its_noise(bench: standoff.Bench) -> None:
    bench.place("coins")
    bench.move(200.0)
    taken = bench.capture(frames=16)
    assert (taken.frames_used, taken.mean_dn.shape) == (16, (64, 96))
    assert taken.height_mm == bench.height_mm
    dim = bench.capture(exposure_us=4000.0, frames=16)
    assert dim.exposure_us == 4000.0
    black = taken.settings.black_level_dn
    # Half the light; the two means have a noise of some 10 DN a pixel, 6144 pixels are averaged.
    assert (dim.mean_dn.mean() - black) / (taken.mean_dn.mean() - black) == pytest.approx(
        0.5, abs=0.005
    )
    # Shot noise at 0 dB: var = mean / gain + (read / gain)^2, with the bench's 5 e-/DN and 12 e-.
    expected = (taken.mean_dn - black) / 5.0 + (12.0 / 5.0) ** 2
    assert np.mean(taken.variance_dn2) == pytest.approx(np.mean(expected), rel=0.02)


def test_the_exposure_of_one_capture_is_not_that_of_the_next(
    bench: standoff.Bench, tmp_path: Path
) -> None:
    bench.move(200.0)
    bench.capture(exposure_us=4000.0, frames=2)
    assert bench.capture(frames=2).exposure_us == 8000.0
    bench.capture(exposure_us=4000.0, frames=2)
    session = bench.sweep([200.0], tmp_path / "session", target="edge", kind="edge")
    assert [record.exposure_us for record in session.records] == [8000.0]


def test_captures_of_a_late_camera_have_the_light_of_their_exposure(
    bench: standoff.Bench,
) -> None:
    bench.place("coins")
    bench.move(200.0)
    simulated(bench).camera.faults = CameraFaults(exposure_delay_frames=(4, 4))
    light = []
    for exposure_us in (None, 2000.0, None):
        taken = bench.capture(exposure_us=exposure_us, frames=4)
        level_dn = float(taken.mean_dn.mean()) - taken.settings.black_level_dn
        light.append(level_dn / taken.exposure_us)
    # A frame in four of the other exposure would be 19 % off or more.
    assert light == pytest.approx([light[0]] * 3, rel=0.01)


def test_a_capture_is_an_image_for_the_rest_of_the_library(bench: standoff.Bench) -> None:
    bench.place("edge", 85.0)
    bench.move(150.0)
    taken = bench.capture()
    far = standoff.zoom_out(taken, 2.0, standoff.GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.7))
    assert far.shape == (32, 48)
    assert standoff.measure_edges(taken)[0].sigma_px == pytest.approx(
        standoff.measure_edges(np.asarray(taken))[0].sigma_px, abs=0.05
    )
    assert len(repr(taken)) < 200
    assert taken._repr_html_().startswith("<table>")
    assert taken.plot().axes


def test_a_sweep_is_a_session_that_the_same_call_resumes(
    bench: standoff.Bench, tmp_path: Path
) -> None:
    out = tmp_path / "session"

    def unplug(done: Any) -> None:
        if done.captured == 2:
            simulated(bench).camera.faults = CameraFaults(disconnect_at=1)

    heights = [150.0, 300.0, 200.0]
    with pytest.raises(DeviceDisconnectedError):
        bench.sweep(heights, out, target="coins", kind="texture", progress=unplug)
    assert len(standoff.Session(out).records) == 2
    bench.close()
    with standoff.Bench(bench.config, operator="Zoë") as again:
        session = again.sweep(heights, out, target="coins", kind="texture")
    assert [record.height_asked_mm for record in session.records] == sorted(heights)
    assert [event.kind for event in session.events].count("resume") == 1
    assert session.manifest.operator == "Zoë"
    assert verify(out).is_ok


def test_a_plan_has_its_targets_placed(bench: standoff.Bench, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(
        'schema = "standoff.plan/1"\nname = "two"\nheights_mm = [150.0]\n'
        'frames_per_capture = 2\n[[targets]]\nkind = "edge"\ntarget = "edge"\n'
        "orientations_deg = [5.0, 95.0]\n"
    )
    session = bench.run(plan, tmp_path / "session")
    lying, upright = (session.load(record).mean_dn for record in session.records)
    # An edge along y differs from column to column, one along x from row to row.
    assert np.ptp(upright.mean(axis=1)) < 0.5 * np.ptp(upright.mean(axis=0))
    assert np.ptp(lying.mean(axis=0)) < 0.5 * np.ptp(lying.mean(axis=1))


def test_a_real_bench_without_anybody_to_place_targets_refuses_several(
    bench: standoff.Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "_opened", cast(Any, Unsimulated(bench)))
    plan = height_series(
        "two",
        [150.0],
        {"kind": "edge", "target": "edge", "orientations_deg": [5.0, 95.0]},
        frames_per_capture=2,
    )
    with pytest.raises(PlanError):
        bench.run(plan, tmp_path / "session")
    with pytest.raises(DeviceError):
        bench.place("coins")
    placed: list[PlanEntry] = []

    def place(entry: PlanEntry) -> Any:
        placed.append(entry)
        return "ready"

    bench.run(plan, tmp_path / "session", place=place)
    assert [entry.orientation_deg for entry in placed] == [5.0, 95.0]


class Unsimulated:
    """The opened simulated bench, as if it were a real one."""

    simulated = None

    def __init__(self, bench: standoff.Bench) -> None:
        opened = bench._open()
        self.camera, self.stage = opened.camera, opened.stage
        self.clock, self.sleep = opened.clock, opened.sleep


def test_the_focus_is_found_and_approached() -> None:
    config = bench_config(simulated__focus_distance_mm=220.0, simulated__f_number=2.0)
    with standoff.Bench(config) as bench:
        peak = bench.focus((180.0, 260.0), steps=11)  # homes the stage
        # The pupil is at the height. A third of the depth of focus, N c d^2 / f^2 = 12 mm.
        assert peak.height_mm == pytest.approx(220.0, abs=4.0)
        assert bench.height_mm == pytest.approx(peak.height_mm, abs=0.01)
        with pytest.raises(NoFocusPeakError):
            bench.focus((300.0, 380.0), steps=11)


def test_a_bench_is_open_inside_its_block_alone() -> None:
    bench = standoff.Bench(bench_config())
    with pytest.raises(DeviceError):
        bench.move(200.0)
    with bench:
        with pytest.raises(DeviceError):
            bench.open()
        with pytest.raises(StageNotHomedError):
            bench.move(200.0)
    with pytest.raises(DeviceError):
        bench.capture()
    assert bench.open().limits_mm == (10.0, 400.0)
    bench.close()
    bench.close()


def test_a_height_beyond_the_travel_moves_nothing(bench: standoff.Bench, tmp_path: Path) -> None:
    before_mm = bench.height_mm
    with pytest.raises(StageLimitError):
        bench.move(401.0)
    with pytest.raises(StageLimitError):
        bench.sweep([150.0, 401.0], tmp_path / "session", target="edge", kind="edge")
    assert bench.height_mm == before_mm
    assert not (tmp_path / "session").exists()


def test_an_interrupt_during_a_move_stops_the_stage(
    bench: standoff.Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = simulated(bench).stage
    stops: list[bool] = []

    def interrupted(*_: float) -> float:
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, "move_to", interrupted)
    monkeypatch.setattr(stage, "stop", lambda: stops.append(True))
    with pytest.raises(KeyboardInterrupt):
        bench.move(200.0)
    assert stops == [True]


def test_a_bench_file_is_read_with_other_settings(tmp_path: Path) -> None:
    path = Path(__file__).parents[3] / "configs" / "simulated.toml"
    bench = standoff.Bench(path, settings={"camera.exposure_us": 4000.0})
    assert bench.config.camera.exposure_us == 4000.0
    with pytest.raises(BenchConfigError):
        standoff.Bench(path, settings={"camera.exposure": 4000.0})
    with pytest.raises(TypeError):
        standoff.Bench(bench_config(), settings={"camera.exposure_us": 4000.0})
    with pytest.raises(TypeError):
        standoff.Bench(cast(Any, 5))


def test_what_a_session_refuses_is_refused(bench: standoff.Bench, tmp_path: Path) -> None:
    out = tmp_path / "session"
    bench.sweep([150.0], out, target="edge", kind="edge")
    with pytest.raises(SessionError):
        bench.sweep([160.0], out, target="edge", kind="edge")
    with pytest.raises(PlanError):
        bench.sweep([150.0, 150.0], tmp_path / "other", target="edge", kind="edge")
    with pytest.raises(PlanError):
        bench.capture(frames=1)
