import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from acquisition.bench import BenchDevices, load_bench
from acquisition.devices import Camera
from acquisition.focus._live import FocusOptions, FocusPoint, focus_values, sweep_focus
from acquisition.focus._measures import Region
from acquisition.focus._sweep import fit_focus_peak
from hil_mocks import SimulatedBench
from tests.acquisition.aravis_bench import needs_aravis
from tests.hil_mocks.gige_bench import gige_bench
from tests.standoff.conftest import SMALL_BENCH, Command

FOCUS_MM = 300.0
SMALL_FRAME = ("--set", "simulated.width_px=64", "--set", "simulated.height_px=48")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A lens of f/1, focused at a height of 300 mm."""
    path = tmp_path / "b.toml"
    path.write_text(SMALL_BENCH + f"focus_distance_mm = {FOCUS_MM}\nf_number = 1.0\n")
    return path


@pytest.mark.slow
def test_a_sweep_ends_at_the_focus_with_its_plot(
    command: Command, bench: Path, tmp_path: Path
) -> None:
    plot = tmp_path / "sweep.png"
    keys = ("--sweep", "--from", 250, "--to", 340, "--steps", 11, "--frames", 4, "--json")
    done = command.done("focus", "--bench", bench, *keys, "--out", plot, "--go")
    found = json.loads(done.out)
    assert found["height_mm"] == pytest.approx(FOCUS_MM, abs=0.9)  # 1 % of the travel
    assert len(found["positions"]) == 11
    assert plot.read_bytes()[:4] == b"\x89PNG"


def test_a_focus_beyond_the_sweep_is_refused_with_the_way_to_go(
    command: Command, bench: Path
) -> None:
    keys = ("--sweep", "--from", 200, "--to", 270, "--steps", 8, "--frames", 3)
    err = command.refused(1, "focus", "--bench", bench, *keys)
    assert "sweep higher" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("metric", ["squared-gradient", "laplacian"])
def test_the_live_aid_ends_after_its_readings(command: Command, bench: Path, metric: str) -> None:
    done = command.done("focus", "--bench", bench, "--readings", 8, "--metric", metric, "--json")
    found = json.loads(done.out)
    assert found["metric"] == metric
    assert 90 < found["percent_of_peak"] <= 100
    assert "% of peak" in done.err


@pytest.mark.slow
def test_the_peak_is_within_one_percent_at_snr_20_with_20_percent_of_drift(bench: Path) -> None:
    # White paper of 400 electrons: SNR 20 by shot noise in each frame; 10 frames as by default.
    keys = {"camera.exposure_us": 267.0, "simulated.read_noise_e": 2.0}
    config = load_bench(bench, keys)
    heights = [float(height) for height in np.linspace(254.0, 346.0, 15).round(1)]
    along_the_edge = Region(x_px=0, y_px=48, width_px=160, height_px=32)
    for seed in range(3):
        rig = SimulatedBench(load_bench(bench, {**keys, "simulated.seed": seed}))
        exposures = iter(np.linspace(0.9, 1.1, len(heights) + 1)[1:] * 267.0)

        def drift(
            _: FocusPoint,
            rig: SimulatedBench = rig,
            exposures: Iterator[np.float64] = exposures,
        ) -> None:
            rig.camera.set_exposure_us(float(next(exposures)))

        rig.place("edge", 5.0)
        points = sweep_focus(
            BenchDevices(
                config=config,
                camera=rig.camera,
                stage=rig.stage,
                clock=lambda rig=rig: rig.clock.now_s,  # type: ignore[misc]  # bound at once
            ),
            heights,
            FocusOptions(measure="tenengrad", region=along_the_edge),
            frames=10,
            progress=drift,
        )
        peak = fit_focus_peak(
            np.array([p.height_mm for p in points]), np.array([p.value for p in points])
        )
        assert abs(peak.height_mm - FOCUS_MM) < 0.01 * 92.0


@pytest.mark.parametrize(("before", "status"), [(0, 130), (9, 0)])
def test_ctrl_c_ends_the_live_aid_well_once_a_value_was_shown(
    command: Command,
    bench: Path,
    monkeypatch: pytest.MonkeyPatch,
    before: int,
    status: int,
) -> None:
    def interrupted(camera: Camera, options: FocusOptions) -> Iterator[float]:
        yield from islice(focus_values(camera, options), before)
        raise KeyboardInterrupt

    monkeypatch.setattr("standoff.library.bench._focus.focus_values", interrupted)
    done = command("focus", "--bench", bench)
    assert done.status == status
    assert ("% of peak" in done.err) == (before > 0)


@pytest.mark.slow
def test_a_sweep_without_heights_goes_over_the_whole_travel_and_then_about_the_best(
    command: Command, bench: Path, tmp_path: Path
) -> None:
    plot = tmp_path / "sweep.png"
    words = ("focus", "--bench", bench, *SMALL_FRAME, "--sweep", "--frames", 2)
    done = command.done(*words, "--out", plot)
    told, wrote = done.out.splitlines()
    assert told.startswith("sharpest at ")
    assert wrote == f"wrote {plot}"
    assert plot.read_bytes()[:4] == b"\x89PNG"
    step_mm = 500 / 14  # from 120 to 620 mm in 15 steps
    # The second sweep is of two steps on either side of the best, at 298.6 mm.
    assert float(told.split()[2]) == pytest.approx(FOCUS_MM, abs=0.01 * 4 * step_mm)
    positions = json.loads(command(*words, "--json").out)["positions"]
    heights = [position["height_mm"] for position in positions]
    assert heights[0] == pytest.approx(120 + 3 * step_mm, abs=0.01)
    assert heights[-1] == pytest.approx(120 + 7 * step_mm, abs=0.01)


def test_a_peak_surer_than_the_stage_stands_is_told_as_such(command: Command, bench: Path) -> None:
    keys = ("--sweep", "--from", 250, "--to", 340, "--steps", 9, "--frames", 2)
    coarse = ("--set", "stage.tolerance_mm=2.0")
    done = command.done("focus", "--bench", bench, *SMALL_FRAME, *keys, *coarse)
    assert done.out.splitlines()[1:] == ["more precise than the stage's tolerance (2 mm)"]


def test_a_saturated_sweep_is_told_with_the_remedy(command: Command, bench: Path) -> None:
    # White paper gives 1.5 e- a microsecond, 60 000 in 40 ms; the ADC ends near 20 000.
    keys = ("--sweep", "--from", 250, "--to", 340, "--steps", 9, "--frames", 2)
    longer = ("--set", "camera.exposure_us=40000")
    done = command("focus", "--bench", bench, *SMALL_FRAME, *keys, *longer)
    assert "parts of the picture are saturated" in done.err
    assert "use a shorter exposure" in done.err


REAL_CAMERA = """
[camera]
driver = "aravis"
address = "{address}"
pixel_format = "Mono12"
exposure_us = 4000.0
gain_db = 0.0
frame_rate_hz = 500.0

[stage]
driver = "manual"
limits_mm = [0.0, 300.0]

[optics]
focal_length_mm = 8.0
pixel_pitch_um = 8.3
"""


@pytest.mark.slow
@needs_aravis
def test_the_live_aid_needs_a_real_camera_alone_and_tells_its_warnings(
    command: Command, tmp_path: Path
) -> None:
    path = tmp_path / "real.toml"
    with gige_bench() as practice:
        practice.place("edge", 5.0)
        path.write_text(REAL_CAMERA.format(address=practice.camera.address))
        done = command.done("focus", "--bench", path, "--readings", 3, "--json")
        assert 0 < json.loads(done.out)["percent_of_peak"] <= 100
        assert "camera.frame_rate_hz" in done.err  # 500 Hz are more than the link carries
        err = command.refused(2, "focus", "--bench", path, "--readings", 3, "--target", "coins")
        assert "only a simulated bench takes a target" in err
        assert practice.camera.controller is None


@pytest.mark.parametrize("target", ["dark", "flat"])
def test_a_lens_cap_and_plain_paper_are_nothing_to_focus_on(
    command: Command, bench: Path, target: str
) -> None:
    live = command.done("focus", "--bench", bench, "--readings", 30, "--target", target)
    assert "nothing to focus on" in live.out
    assert "% of peak" not in live.out + live.err
    sweep = ("--sweep", "--from", 180, "--to", 280, "--steps", 8, "--frames", 3)
    err = command.refused(1, "focus", "--bench", bench, *sweep, "--target", target)
    assert "nothing to focus on" in err
