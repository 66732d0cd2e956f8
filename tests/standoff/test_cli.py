import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import acquisition.photographs._reader
import standoff.cli
import standoff.commands
from standoff import __version__
from standoff.errors import ApplicationError
from standoff.shipped_configs import shipped_config
from standoff.terminal._app import COMMANDS
from tests.calibration.closed_form import edge_image
from tests.standoff.conftest import Command


def assert_one_line(text: str) -> None:
    assert text.endswith("\n")
    assert len(text.strip().splitlines()) == 1


def test_the_version_is_printed(command: Command) -> None:
    done = command("--version")
    assert (done.status, done.out) == (0, f"standoff {__version__}\n")


@pytest.mark.slow
def test_the_shell_completes_commands_and_options() -> None:
    for words, number, expected in (
        ("standoff cal", 1, "calibrate"),
        ("standoff limits --foc", 2, "--focal-length-px"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "standoff"],
            env={
                **os.environ,
                "_STANDOFF_COMPLETE": "complete_bash",
                "COMP_WORDS": words,
                "COMP_CWORD": str(number),
            },
            capture_output=True,
            text=True,
            check=True,
        )
        assert expected in done.stdout
        assert done.stderr == ""


def test_without_a_command_the_help_says_what_there_is(command: Command) -> None:
    done = command()
    assert done.status == 2
    for name in ("demo", "capture", "verify", "calibrate", "simulate", "report"):
        assert name in done.out


@pytest.mark.parametrize(
    "arguments",
    [
        ["unknown"],
        ["simulate"],
        ["simulate", "x.tif", "--out", "o.tif", "--zoom", "0.5", "--model", "bicubic"],
        ["simulate", "x.tif", "--out", "o.tif", "--zoom", "nan", "--model", "bicubic"],
        ["simulate", "x.tif", "--out", "o.tif", "--zoom", "inf", "--model", "bicubic"],
        ["simulate", "x.tif", "--out", "o.tif", "--zoom", "two"],
        ["simulate", "x.tif", "--out", "o.tif", "--zoom", "2"],
        ["simulate", "x.tif", "--out", "o.tif", "--zoom", "2", "--model", "magic"],
        ["calibrate", "--out", "psf.json"],
        ["calibrate", "x.tif", "--session", "s", "--out", "psf.json"],
        ["calibrate", "x.tif", "--out", "psf.json", "--region", "everywhere"],
        ["calibrate", "x.tif", "--out", "psf.json", "--method", "guess"],
        ["demo", "--set", "camera.colour=red"],
        ["demo", "--set", "camera"],
        ["demo", "--set", "simulated.seed=-1"],
    ],
)
def test_wrong_usage_is_one_line_and_status_2(
    command: Command, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = command(*arguments)
    assert done.status == 2
    assert done.out == ""
    assert_one_line(done.err)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["simulate", "x.tif", "--out", "o.tif", "--zoom", "1,5"], "write 1.5"),
        (["simulate", "x.tif", "--out", "o.tif", "--zoom", "0.5"], "the ratio of distances is 2"),
        (["stage", "move", "0,3", "--bench", "b.toml"], "write 0.3"),
        (["demo", "--set", "camera.exposure_us=9"], 'write 9000, or "9 us" if it is right'),
        (["demo", "--set", "camera.exposure=9"], "did you mean camera.exposure_us?"),
        (["demmo"], "Did you mean 'demo'?"),
        (["simulate", "x.tif", "--out", "o.tif", "--zom", "2"], "--zoom"),
    ],
)
def test_a_slip_on_the_command_line_is_answered_with_what_to_write(
    command: Command, arguments: list[str], remedy: str
) -> None:
    err = command.refused(2, *arguments)
    assert_one_line(err)
    assert remedy in err


def test_a_slip_in_a_bench_file_is_a_data_error_and_a_stated_unit_is_none(
    command: Command, tmp_path: Path
) -> None:
    text = shipped_config("simulated.toml").read_text("utf-8")
    bench = tmp_path / "bench.toml"
    bench.write_text(text.replace("exposure_us = 9000.0", "exposure_us = 9"), encoding="utf-8")
    err = command.refused(1, "stage", "status", "--bench", bench)
    assert_one_line(err)
    assert f"{bench}: camera.exposure_us = 9" in err
    bench.write_text(text.replace("exposure_us = 9000.0", 'exposure_us = "9 ms"'), encoding="utf-8")
    command.done("stage", "status", "--bench", bench)


def _write_bad_inputs(folder: Path) -> None:
    (folder / "text.tif").write_text("not an image")
    (folder / "text.png").write_text("not an image")
    whole = folder / "whole.tif"
    tifffile.imwrite(whole, np.rint(edge_image(0.8, 5.0)).astype(np.uint16))
    (folder / "cut.tif").write_bytes(whole.read_bytes()[:9000])
    Image.fromarray(np.full((60, 70), 90, np.uint8)).save(folder / "flat.png")
    (folder / "cut.png").write_bytes((folder / "flat.png").read_bytes()[:70])
    clipped = np.minimum(edge_image(0.8, 5.0) / 200.0, 255.0)
    Image.fromarray(np.rint(clipped).astype(np.uint8)).save(folder / "clipped.png")
    nan = edge_image(0.8, 5.0).astype(np.float32)
    nan[3, 4] = np.nan
    tifffile.imwrite(folder / "nan.tif", nan)
    good: dict[str, object] = {
        "schema": "standoff.psf/1",
        "sigma_x_px": 0.8,
        "sigma_y_px": 0.7,
        "rho": 0.0,
    }
    variants: dict[str, dict[str, object]] = {
        "good": {},
        "schema": {"schema": "standoff.noise/1"},
        "null": {"sigma_y_px": None},
        "text": {"sigma_x_px": "wide"},
        "negative": {"sigma_x_px": -1.0},
    }
    for name, changes in variants.items():
        (folder / f"{name}.json").write_text(json.dumps(good | changes))
    (folder / "broken.json").write_text("{")


SIMULATE = ["--zoom", "2", "--out", "o.tif", "--psf"]


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["calibrate", "text.tif", "--out", "p.json"], ["text.tif", "TIFF"]),
        (["calibrate", "text.png", "--out", "p.json"], ["text.png", "not an image"]),
        (["calibrate", "cut.tif", "--out", "p.json"], ["cut.tif"]),
        (["calibrate", "cut.png", "--out", "p.json"], ["cut.png"]),
        (["calibrate", "nan.tif", "--out", "p.json"], ["nan.tif", "finite"]),
        (["calibrate", "missing.tif", "--out", "p.json"], ["missing.tif"]),
        (["calibrate", "flat.png", "--out", "p.json"], ["flat.png", "no straight edge"]),
        (["calibrate", "clipped.png", "--out", "p.json"], ["clipped.png", "saturated"]),
        (["calibrate", "whole.tif", "--out", "no/p.json"], ["no/p.json"]),
        (["calibrate", "whole.tif", "--out", "p.json", "--channel", "red"], ["whole.tif", "red"]),
        (
            ["calibrate", "whole.tif", "--out", "p.json", "--region", "500,0,50,50"],
            ["whole.tif", "region"],
        ),
        (["calibrate", "--session", ".", "--out", "p.json"], ["not a capture session"]),
        (["simulate", "whole.tif", *SIMULATE, "schema.json"], ["schema.json", "schema"]),
        (["simulate", "whole.tif", *SIMULATE, "null.json"], ["null.json", "sigma_y_px"]),
        (["simulate", "whole.tif", *SIMULATE, "text.json"], ["text.json", "sigma_x_px"]),
        (["simulate", "whole.tif", *SIMULATE, "negative.json"], ["negative.json", "sigma_x_px"]),
        (["simulate", "whole.tif", *SIMULATE, "broken.json"], ["broken.json"]),
        (["simulate", "whole.tif", *SIMULATE, "missing.json"], ["missing.json"]),
        (["simulate", "cut.tif", *SIMULATE, "good.json"], ["cut.tif"]),
        (
            ["simulate", "whole.tif", "--zoom", "2", "--out", "no/o.tif", "--psf", "good.json"],
            ["no/o.tif"],
        ),
        (
            ["simulate", "whole.tif", "--zoom", "500", "--out", "o.tif", "--psf", "good.json"],
            ["500"],
        ),
        (["verify", "."], ["not a capture session"]),
        (["report", "."], ["not a capture session"]),
        (["capture", "--bench", "b.toml", "--plan", "p.toml", "--out", "s"], ["b.toml"]),
    ],
)
def test_wrong_input_is_one_line_that_names_it_and_status_1(
    command: Command,
    arguments: list[str],
    names: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _write_bad_inputs(tmp_path)
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    done = command(*arguments)
    assert done.status == 1
    assert done.out == ""
    assert_one_line(done.err)
    for name in names:
        assert name in done.err
    assert sorted(tmp_path.iterdir()) == before  # nothing half-written


def test_ctrl_c_is_status_130(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(path: Path, options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(acquisition.photographs._reader, "read_photograph", interrupt)
    done = command(
        "simulate", "x.tif", "--zoom", "2", "--model", "bicubic", "--out", tmp_path / "o.tif"
    )
    assert done.status == 130
    assert_one_line(done.err)


def test_the_installed_command_runs_in_a_process_of_its_own() -> None:
    script = Path(sys.executable).with_name("standoff")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"standoff {__version__}\n"


def test_the_package_runs_as_a_module() -> None:
    words = [sys.executable, "-m", "standoff", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout == f"standoff {__version__}\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "edge.tif", "--out", "edge.tif"],
        ["calibrate", "edge.tif", "--out", "p.json", "--report", "p.json"],
        ["simulate", "edge.tif", "--zoom", "2", "--model", "bicubic", "--out", "./edge.tif"],
    ],
)
def test_a_result_never_takes_the_place_of_an_input_or_of_another_result(
    command: Command,
    arguments: list[str],
    edge_file: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = edge_file.read_bytes()
    monkeypatch.chdir(edge_file.parent)
    err = command.refused(2, *arguments)
    assert_one_line(err)
    assert edge_file.read_bytes() == before


def test_levels_beyond_float32_are_refused_before_anything_is_written(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "far.tif"
    err = command.refused(
        2,
        "simulate",
        edge_file,
        "--zoom",
        2,
        "--model",
        "bicubic",
        "--exposure",
        1e36,
        "--out",
        out,
    )
    assert "exposure: expected a number of 1e+12 at most" in err
    assert not out.exists()


def test_a_file_where_the_results_folder_should_be_is_named(
    command: Command, session_dir: Path
) -> None:
    (session_dir / "results").write_text("in the way")
    err = command.refused(1, "report", session_dir)
    assert_one_line(err)
    assert "results" in err


def test_every_module_of_the_commands_is_within_reach() -> None:
    folder = Path(standoff.commands.__file__).parent
    within_reach = {path.split(":")[0] for path in COMMANDS.values()}
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    groups = {path.parent.name for path in folder.glob("*/__init__.py")}
    assert within_reach == modules | groups


def test_a_folder_in_the_place_of_a_result_is_named_before_any_work(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "psf.json").mkdir()
    err = command.refused(1, "calibrate", edge_file, "--out", tmp_path / "psf.json")
    assert f"cannot write {tmp_path / 'psf.json'}: it is a folder" in err
    assert_one_line(err)


def test_a_report_that_the_disk_does_not_take_is_named(
    command: Command, session_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("acquisition.files._writing.write_shared", full)
    assert "report.html: No space left on device" in command.refused(1, "report", session_dir)


def test_sigterm_ends_a_command_as_ctrl_c_does_with_a_status_of_its_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def told_to_end(_: Path, options: object) -> None:
        signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(acquisition.photographs._reader, "read_photograph", told_to_end)
    words = ["simulate", "x.tif", "--zoom", "2", "--model", "bicubic", "--out", "o.tif"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["standoff", *words])
    with pytest.raises(SystemExit) as ended:
        standoff.cli.main()
    assert ended.value.code == 143
    assert_one_line(capsys.readouterr().err)
    assert signal.getsignal(signal.SIGTERM) is before
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_the_installation_lacks_is_named() -> None:
    with pytest.raises(ApplicationError):
        shipped_config("other.toml")
