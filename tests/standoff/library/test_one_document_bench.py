"""The bench: the command prints what the function returns."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest

import acquisition.aravis
import standoff
from acquisition.aravis import FoundCamera
from acquisition.capture import CaptureProgress
from acquisition.focus import FocusPoint, FocusReading, NoFocusPeakError
from acquisition.plan import PlanEntry, PlanEstimate, load_plan
from calibration.edges import Region
from calibration.geometry import GeometryCalibration
from tests.standoff.conftest import SMALL_BENCH, SMALL_PLAN, Command
from tests.standoff.library.one_document import printed

FOCUS_MM = 300.0
SMALL = {"simulated.width_px": 64, "simulated.height_px": 48}
LARGER = {"simulated.width_px": 160, "simulated.height_px": 120}
SMALL_WORDS = [word for key, value in SMALL.items() for word in ("--set", f"{key}={value}")]


@pytest.fixture
def fast_lens(tmp_path: Path) -> Path:
    """A bench with a lens of f/1, focused at a height of 300 mm."""
    return fast_bench(tmp_path / "f.toml", f_number=1.0)


def fast_bench(path: Path, *, f_number: float) -> Path:
    """A bench with a lens that is focused at 300 mm from its entrance pupil."""
    path.write_text(f"{SMALL_BENCH}focus_distance_mm = {FOCUS_MM}\nf_number = {f_number}\n")
    return path


def test_capture(command: Command, bench_file: Path, plan_file: Path, tmp_path: Path) -> None:
    by_command, by_function = tmp_path / "by-command", tmp_path / "by-function"
    words = ("--bench", bench_file, "--plan", plan_file, "--out", by_command)
    done = command("capture", *words, "--yes", "--json")
    asked: list[PlanEntry] = []
    expected: list[PlanEstimate] = []
    seen: list[CaptureProgress] = []

    def skips_the_last(entry: PlanEntry) -> str:
        asked.append(entry)
        return "skip" if entry.orientation_deg == 95.0 else "ready"

    found = standoff.capture_session(
        plan_file,
        bench_file,
        by_function,
        operator="Ada",
        place=skips_the_last,  # type: ignore[arg-type]  # one of the two words
        begun=expected.append,
        captured=seen.append,
    )
    assert [entry.orientation_deg for entry in asked] == [5.0, 50.0, 95.0]
    assert (found.captured, found.skipped) == (4, 2)
    assert [one.captured for one in seen] == [1, 2, 3, 4]
    assert [one.captures for one in expected] == [6]
    resumed = standoff.capture_session(load_plan(plan_file), bench_file, by_function, retake=[0])
    document = {**printed(done), "session": str(by_function)}
    assert document == {**resumed.to_json(), "captured": 6, "already_captured": 0}
    assert (resumed.captured, resumed.already_captured) == (3, 3)
    assert standoff.Session(by_function).is_complete
    assert standoff.Session(by_function).manifest.operator == "Ada"


def test_capture_dry_run(
    command: Command, bench_file: Path, plan_file: Path, session_dir: Path
) -> None:
    words = ("--bench", bench_file, "--plan", plan_file, "--out", session_dir)
    done = command("capture", *words, "--dry-run", "--json")
    found = standoff.preview_plan(plan_file, bench_file, session_dir)
    assert printed(done) == found.to_json()
    assert all(note in done.err for note in found.notes)
    assert "already contains a session" in found.notes[-1]
    assert standoff.preview_plan(plan_file, bench_file).notes == ()


def test_a_capture_with_a_fault_is_noted(bench_file: Path, tmp_path: Path) -> None:
    plan = tmp_path / "p.toml"
    plan.write_text(SMALL_PLAN.replace("[5.0, 50.0, 95.0]", "[5.0]\nexposure_us = [500000.0]"))
    found = standoff.capture_session(plan, bench_file, tmp_path / "s")
    assert any(note.startswith("capture 0: saturated") for note in found.notes)


def test_focus(command: Command, fast_lens: Path, noise_file: Path) -> None:
    words = ("--readings", 8, "--frames", 4, "--metric", "laplacian", "--region", "10,10,60,50")
    done = command("focus", "--bench", fast_lens, *words, "--noise", noise_file, "--json")
    shown: list[tuple[FocusReading, float]] = []
    found = standoff.watch_focus(
        fast_lens,
        lambda reading, time_s: shown.append((reading, time_s)),
        readings=8,
        frames=4,
        measure="laplacian",
        region=Region(x_px=10, y_px=10, width_px=60, height_px=50),
        noise=noise_file,
    )
    assert printed(done) == found.to_json()
    assert shown[-1][0] == found.reading
    times_s = [time_s for _, time_s in shown]
    assert times_s == sorted(times_s)


@pytest.mark.slow
def test_focus_sweep(command: Command, fast_lens: Path, tmp_path: Path) -> None:
    words = ("--sweep", "--from", 250, "--to", 340, "--steps", 8, "--frames", 3, "--target", "edge")
    plot = tmp_path / "command.png"
    done = command("focus", "--bench", fast_lens, *SMALL_WORDS, *words, "--out", plot, "--json")
    points: list[FocusPoint] = []
    found = standoff.find_focus(
        fast_lens,
        (250, 340),
        settings=SMALL,
        steps=8,
        frames=3,
        target="edge",
        measured=points.append,
    )
    assert printed(done) == found.to_json()
    assert found.peak.height_mm == pytest.approx(FOCUS_MM, abs=3)
    assert found.half_interval_mm == pytest.approx(1.96 * found.peak.err_mm, rel=1e-4)
    assert tuple(points) == found.sweep.points
    found.write_plot(tmp_path / "function.png")
    assert (tmp_path / "function.png").read_bytes()[:4] == plot.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_a_geometry_tells_a_sweep_where_the_entrance_pupil_is(
    command: Command, tmp_path: Path
) -> None:
    deep, offset_mm = fast_bench(tmp_path / "f4.toml", f_number=4.0), 12.5
    focus_mm = FOCUS_MM - offset_mm
    geometry = GeometryCalibration.model_construct(
        pupil_offset_mm=offset_mm, pupil_offset_err_mm=0.03
    )
    sweep = {
        "settings": LARGER | {"simulated.pupil_offset_mm": offset_mm},
        "steps": 9,
        "frames": 4,
        "target": "edge",
    }
    heights_mm = (focus_mm - 60, focus_mm + 60)
    known = standoff.find_focus(deep, heights_mm, geometry=geometry, **sweep)  # type: ignore[arg-type]  # as they are named
    unknown = standoff.find_focus(deep, heights_mm, **sweep)  # type: ignore[arg-type]  # as they are named
    for found in (known, unknown):
        assert abs(found.peak.height_mm - focus_mm) < 3 * found.peak.err_mm
    assert known.peak.err_mm < unknown.peak.err_mm
    assert known.peak.pupil_err_mm < 0.1 * unknown.peak.pupil_err_mm
    assert known.to_json()["height_err_pupil_mm"] == known.peak.pupil_err_mm
    done = command("focus", "--bench", deep, "--geometry", tmp_path / "none.json", "--sweep")
    assert done.status == 1
    assert "none.json" in done.err
    with pytest.raises(TypeError, match="geometry"):
        standoff.find_focus(deep, heights_mm, geometry=12.5)  # type: ignore[arg-type]  # none


def test_a_sweep_beside_the_focus_says_where_to_look(fast_lens: Path) -> None:
    found = standoff.find_focus(fast_lens, (200, 270), settings=SMALL, steps=8, frames=3)
    assert found.sweep.peak is None
    with pytest.raises(NoFocusPeakError, match="sweep higher"):
        _ = found.peak
    with pytest.raises(standoff.ArgumentError, match="lower one first"):
        standoff.find_focus(fast_lens, (270, 200))


@pytest.mark.parametrize(
    ("argument", "value", "said"),
    [
        ("target", "nothing", "nothing"),
        ("region", Region(x_px=0, y_px=0, width_px=1000, height_px=10), "reaches beyond"),
    ],
)
def test_what_cannot_be_placed_or_seen_is_an_argument_error(
    fast_lens: Path, argument: str, value: object, said: str
) -> None:
    with pytest.raises(standoff.ArgumentError, match=said) as refused:
        standoff.watch_focus(fast_lens, readings=1, **{argument: value})  # type: ignore[arg-type]  # one of two
    assert refused.value.argument == argument


def test_cameras(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    there = FoundCamera(
        address="10.0.0.7",
        vendor="Allied Vision",
        model="Manta G-046B",
        serial_number="S1",
        hardware_address="00:0f:31:00:00:01",
    )
    monkeypatch.setattr(acquisition.aravis, "list_cameras", lambda: (there,))
    found = standoff.find_cameras()
    document = json.loads(command("cameras", "--json").out)
    assert document == {"cameras": [asdict(camera) for camera in found]}
    assert found == (there,)
