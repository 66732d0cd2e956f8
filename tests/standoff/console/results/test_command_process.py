"""A command in a process of its own: what it says, and how it ends."""

import io
from pathlib import Path

import pytest

from acquisition.errors import OperatorStopError
from standoff.console.results import command_process
from standoff.console.results.command_process import CommandProgress, run_command
from standoff.errors import ApplicationError


def test_progress_remarks_and_the_reason_of_a_failure_are_told_apart() -> None:
    told: list[CommandProgress] = []
    said = command_process._Said(told.append)
    said.hear(
        io.StringIO(
            "note: compiling the numerical code, once: a minute or two\n"
            "measuring edges: 3 of 12 after 4 s\n"
            "note: 8 of 246 edges do not fit\n"
            "standoff: there is no edge\n"
        )
    )
    assert told[0].text.startswith("compiling")
    assert told[1:] == [CommandProgress(text="measuring edges", done=3, total=12)]
    assert said.remarks == ["8 of 246 edges do not fit"]
    assert said.fault == "there is no edge"


@pytest.mark.slow
def test_a_command_that_fails_gives_its_own_reason(tmp_path: Path) -> None:
    absent = tmp_path / "none.json"
    with pytest.raises(ApplicationError) as error:
        run_command(("compare", str(absent), str(absent)), check=lambda: None)
    assert "none.json" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_command_prints_its_document(tmp_path: Path) -> None:
    psf = tmp_path / "psf.json"
    psf.write_text(
        '{"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_x_err_px": 0.01,'
        ' "sigma_y_px": 0.8, "sigma_y_err_px": 0.01, "rho": 0.1, "rho_err": 0.01}'
    )
    result = run_command(("compare", str(psf), str(psf)), check=lambda: None)
    assert isinstance(result.document["verdict"], str)


@pytest.mark.slow
def test_a_command_that_is_stopped_ends_at_once(tmp_path: Path) -> None:
    checks = []

    def stop_at_the_second_check() -> None:
        checks.append(1)
        if len(checks) == 2:
            raise OperatorStopError("stopped")

    with pytest.raises(OperatorStopError):
        run_command(("demo", "--out", str(tmp_path / "demo")), check=stop_at_the_second_check)
    assert not (tmp_path / "demo").exists() or not list((tmp_path / "demo").glob("*.html"))
