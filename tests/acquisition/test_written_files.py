"""Slips in a bench file, a plan and an override are named; what was captured before is read."""

import re
from pathlib import Path

import pytest

from acquisition.bench import BenchConfig, load_bench, parse_overrides
from acquisition.errors import BenchConfigError, PlanError
from acquisition.plan import load_plan, parse_plan
from calibration.errors import LimitsFileError
from calibration.sharpness import read_limits

CONFIGS = Path(__file__).parents[2] / "configs"
BENCH = CONFIGS / "simulated.toml"


def bench_with(old: str, new: str, folder: Path) -> BenchConfig:
    text = BENCH.read_text("utf-8")
    assert old in text
    path = folder / "bench.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return load_bench(path)


def refused_override(setting: str) -> BenchConfigError:
    with pytest.raises(BenchConfigError) as refused:
        load_bench(BENCH, parse_overrides([setting]))
    return refused.value


def write_plan(old: str, new: str, folder: Path) -> Path:
    text = (CONFIGS / "demo_plan.toml").read_text("utf-8")
    assert old in text
    path = folder / "plan.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def test_an_implausible_number_in_a_bench_file_names_file_key_slip_and_remedy(
    tmp_path: Path,
) -> None:
    with pytest.raises(BenchConfigError) as refused:
        bench_with("exposure_us = 9000.0", "exposure_us = 9", tmp_path)
    assert refused.value.keys == ("camera.exposure_us",)
    assert refused.value.path == tmp_path / "bench.toml"
    assert str(refused.value) == (
        f"bench file {tmp_path / 'bench.toml'}: camera.exposure_us = 9 is 9 microseconds; "
        'milliseconds were probably meant: write 9000, or "9 us" if it is right'
    )


@pytest.mark.parametrize(
    ("written", "exposure_us"), [('"9 us"', 9.0), ('"9 ms"', 9000.0), ('"9000"', 9000.0)]
)
def test_a_number_that_states_its_unit_is_taken(
    written: str, exposure_us: float, tmp_path: Path
) -> None:
    config = bench_with("exposure_us = 9000.0", f"exposure_us = {written}", tmp_path)
    assert config.camera.exposure_us == exposure_us
    assert parse_overrides([f"camera.exposure_us={written}"])
    overridden = load_bench(BENCH, parse_overrides([f"camera.exposure_us={written}"]))
    assert overridden == config


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("optics.focal_length_mm=0.008", "optics.focal_length_mm"),
        ("stage.limits_mm=[0.12, 0.62]", "stage.limits_mm"),
        ("camera.gain_db=256", "camera.gain_db"),
        ("camera.exposure_us=9 bananas", "camera.exposure_us"),
        ("camera.exposure_us=9000,0", "camera.exposure_us"),
        ("simulated.f_number=5,6", "simulated.f_number"),
    ],
)
def test_a_slip_in_an_override_names_the_key(setting: str, key: str) -> None:
    assert refused_override(setting).keys == (key,)


def test_a_quoted_decimal_comma_is_answered_with_the_point() -> None:
    assert "write 9000.0" in str(refused_override("camera.exposure_us=9000,0"))
    assert "write 5.6" in str(refused_override("simulated.f_number=5,6"))
    # Of a list only the count tells.
    assert "with a point" in str(refused_override("stage.limits_mm=[120,5, 620,0]"))


def test_a_decimal_comma_outside_quotes_is_named_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(BenchConfigError) as refused:
        bench_with("exposure_us = 9000.0", "exposure_us = 9000,0", tmp_path)
    assert "line 6: exposure_us = 9000,0: write 9000.0" in str(refused.value)


@pytest.mark.parametrize(
    ("setting", "nearest"),
    [
        ("camera.exposure=9000", "camera.exposure_us"),
        ("optics.gain_db=1", "camera.gain_db"),
        ("exposure_us=9000", "camera.exposure_us"),
    ],
)
def test_an_unknown_key_of_an_override_is_answered_with_the_nearest(
    setting: str, nearest: str
) -> None:
    with pytest.raises(BenchConfigError) as refused:
        parse_overrides([setting])
    assert f"did you mean {nearest}?" in str(refused.value)


def test_an_unknown_key_of_a_file_is_answered_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(BenchConfigError) as bench:
        bench_with("gain_db", "gain", tmp_path)
    assert "unknown key camera.gain; did you mean camera.gain_db?" in str(bench.value)
    plan = write_plan("orientations_deg", "orientation_deg", tmp_path)
    with pytest.raises(PlanError) as refused:
        load_plan(plan)
    assert refused.value.keys == ("targets.0.orientation_deg",)
    assert "did you mean targets.0.orientations_deg?" in str(refused.value)


HEIGHTS = "heights_mm = [180.0, 280.0, 400.0]"


@pytest.mark.parametrize("heights", ["[0.18, 0.28, 0.4]", "{start = 0.1, stop = 0.4, step = 0.1}"])
def test_heights_of_a_plan_in_metres_are_asked_about(heights: str, tmp_path: Path) -> None:
    with pytest.raises(PlanError) as refused:
        load_plan(write_plan(HEIGHTS, f"heights_mm = {heights}", tmp_path))
    assert refused.value.keys == ("heights_mm",)


def test_heights_and_exposures_of_a_plan_may_state_their_units(tmp_path: Path) -> None:
    heights = 'heights_mm = {start = "0.1 m", stop = "200 mm", step = "5 cm"}'
    assert load_plan(write_plan(HEIGHTS, heights, tmp_path)).heights_mm == (100.0, 150.0, 200.0)
    exposures = 'target = "edge"\nexposure_us = ["9 us", "9 ms"]'
    plan = load_plan(write_plan('target = "edge"', exposures, tmp_path))
    assert plan.targets[0].exposure_us == (9.0, 9000.0)


def test_an_exposure_of_a_plan_is_asked_about_with_its_target(tmp_path: Path) -> None:
    with pytest.raises(PlanError) as refused:
        load_plan(write_plan('target = "edge"', 'target = "edge"\nexposure_us = 9', tmp_path))
    assert refused.value.keys == ("targets.0.exposure_us",)


def test_what_a_session_recorded_is_read_whatever_its_size() -> None:
    stored = load_bench(BENCH, parse_overrides(["camera.exposure_us=9 us"])).model_dump(mode="json")
    assert BenchConfig.model_validate(stored).camera.exposure_us == 9.0
    plan = {
        "schema": "standoff.plan/1",
        "name": "p",
        "heights_mm": [0.2],
        "targets": [{"kind": "edge", "target": "E", "exposure_us": 1.0}],
    }
    assert parse_plan(plan, source="session.json").heights_mm == (0.2,)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.name)
def test_no_shipped_file_is_asked_about(path: Path) -> None:
    if path.name.endswith(("_plan.toml", "_validation.toml", "_short.toml")):
        load_plan(path)
    elif path.name == "limits.toml":
        read_limits(path)
    else:
        load_bench(path)


def number_keys() -> list[str]:
    """Lines of the shipped bench file that set a number, or numbers."""
    lines = BENCH.read_text("utf-8").splitlines()
    return [line for line in lines if re.match(r"\w+ = (-?\d[\d_.]*|\[-?\d.*\])( *#.*)?$", line)]


@pytest.mark.parametrize("line", number_keys())
def test_a_boolean_is_no_number_of_a_bench_file(line: str, tmp_path: Path) -> None:
    key = line.partition(" = ")[0]
    for written in ("true", "[true, 2.0]" if "[" in line else "false"):
        with pytest.raises(BenchConfigError) as refused:
            bench_with(f"{line}\n", f"{key} = {written}\n", tmp_path)
        assert any(found.endswith(f".{key}") for found in refused.value.keys)
        assert "expected a number" in str(refused.value)


def test_a_boolean_is_no_number_of_an_override_a_plan_or_limits(tmp_path: Path) -> None:
    assert refused_override("stage.settle_s=true").keys == ("stage.settle_s",)
    plan = write_plan("heights_mm = [", "heights_mm = [true, ", tmp_path)
    with pytest.raises(PlanError) as refused:
        load_plan(plan)
    assert "heights_mm" in refused.value.keys
    limits = tmp_path / "limits.toml"
    limits.write_text("[zones]\ncorner_radius = true\n", encoding="utf-8")
    with pytest.raises(LimitsFileError) as unlimited:
        read_limits(limits)
    assert "zones.corner_radius: expected a number" in str(unlimited.value)


def test_a_boolean_is_taken_where_one_belongs(tmp_path: Path) -> None:
    config = bench_with("[camera]", "[camera]\nchunk_data = false", tmp_path)
    assert config.camera.chunk_data is False
