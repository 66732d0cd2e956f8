import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from analysis.validation import _kernels as kernels
from simulation.kernelgan import EstimatedKernel, KernelGanSettings
from standoff.library import Call, validation as validation_run
from tests.analysis.height_series import height_series
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

FILES = {
    "report.html", "validation.json", "curves.csv",
    *(f"table_{n}.{suffix}" for n in (1, 2) for suffix in ("txt", "csv", "tex")),
    *(f"figure_{n}.{suffix}" for n in (2, 3) for suffix in ("png", "svg")),
}  # fmt: skip


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return height_series(tmp_path_factory.mktemp("series") / "session", other_target_at=150.0).path


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A series of which capture 2 is excluded before anything is aligned."""
    return height_series(tmp_path_factory.mktemp("shaken") / "session", shaken_at={150.0: 1.5}).path


@pytest.fixture(scope="module")
def psf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("psf") / "psf.json"
    width_px = (0.6**2 + 1 / 12) ** 0.5
    path.write_text(
        json.dumps(
            {
                "schema": "standoff.psf/1",
                "sigma_x_px": width_px,
                "sigma_y_px": width_px,
                "rho": 0.0,
            }
        )
    )
    return path


@pytest.mark.slow
def test_a_session_becomes_tables_figures_and_a_report(
    command: Command, series: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "validation"
    arguments = ("validate", "--session", series, "--psf", psf, "--out", out)
    done = command.done(*arguments, "--models", "paper, bicubic", "--json")
    assert {path.name for path in out.iterdir()} == FILES
    document = json.loads(done.out)
    assert document == json.loads((out / "validation.json").read_text())
    assert_provenance(document, "validate", series / "journal.jsonl", psf)
    assert "standoff validate" in (out / "report.html").read_text()
    # In the order of the tables, whatever the order they were asked for in.
    assert document["models"] == ["bicubic", "paper"]
    assert [one["capture"] for one in document["excluded"]] == [2]
    assert "excluded: capture 2 (leaves at 150 mm): it does not match capture 0" in done.err


@pytest.mark.slow
def test_the_tables_are_printed_for_people(
    command: Command, shaken: Path, psf: Path, tmp_path: Path
) -> None:
    done = command.done(
        f"validate --session {shaken} --psf {psf} --out {tmp_path / 'v'} --models matched "
        "--references 1"
    )
    for words in ("Table I:", "Table II:", "followup-grid", "the paper's own", "report.html"):
        assert words in done.out


@pytest.mark.slow
def test_the_report_and_the_validation_of_a_session_have_the_same_numbers(
    command: Command, shaken: Path, psf: Path, tmp_path: Path
) -> None:
    session = Path(shutil.copytree(shaken, tmp_path / "session"))
    results = session / "results"
    results.mkdir()
    calibration = results / "psf.json"
    calibration.write_bytes(psf.read_bytes())
    command.done("report", session)
    reported = json.loads((results / "validation.json").read_text())
    done = command.done(
        f"validate --session {session} --psf {calibration} --out {tmp_path / 'v'} "
        "--models bicubic,paper,matched,lmmse --json"
    )
    assert_provenance(reported, "report", session / "journal.jsonl", calibration)
    validated = json.loads(done.out)
    assert_provenance(validated, "validate", session / "journal.jsonl", calibration)
    assert validated | {"provenance": None} == reported | {"provenance": None}
    assert [one["capture"] for one in validated["excluded"]] == [2]
    page = (results / "report.html").read_text()
    for row in reported["table_2"]:
        if row["alignment"] == "followup-grid":
            assert f"<td>{row['mse_dn2']:.2f}</td>" in page
    for name in ("table_1", "table_2"):
        for suffix in (".txt", ".csv", ".tex"):
            table = f"{name}{suffix}"
            assert (results / table).read_bytes() == (tmp_path / "v" / table).read_bytes()


@pytest.mark.slow
def test_a_report_takes_the_validation_that_is_there_while_it_is_current(
    command: Command, psf: Path, tmp_path: Path
) -> None:
    session = height_series(tmp_path / "session", heights_mm=(100.0, 120.0, 150.0)).path
    results = session / "results"
    results.mkdir()
    calibration = results / "psf.json"
    calibration.write_bytes(psf.read_bytes())
    command.done(
        f"validate --session {session} --psf {calibration} --out {results} --models paper "
        "--references 1"
    )
    stored = results / "validation.json"
    before = stored.read_bytes()
    command.done("report", session)
    assert stored.read_bytes() == before
    # What a person decides about a capture afterwards counts.
    command.done("session", "exclude", 1, session, "--reason", "hair")
    done = command("report", session)
    assert "validation.json is older than the last change of the session's captures" in done.err
    anew = json.loads(stored.read_text())
    assert [(pair["reference"], pair["followup"]) for pair in anew["pairs"]] == [(0, 2)]
    assert anew["models"] == ["bicubic", "paper", "matched", "lmmse"]
    # And another calibration.
    wider = json.loads(calibration.read_text()) | {"sigma_x_px": 0.8}
    calibration.write_text(json.dumps(wider))
    done = command("report", session)
    assert "validation.json is of another PSF" in done.err
    assert json.loads(stored.read_text())["psf_covariance_px2"][0][0] == pytest.approx(0.64)


def identity_kernel() -> EstimatedKernel:
    weights = np.zeros((13, 13))
    weights[6, 6] = 1.0
    return EstimatedKernel(weights=weights)


@pytest.mark.slow
def test_interrupted_it_goes_on_with_the_kernels_that_were_trained(
    command: Command, shaken: Path, psf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained: list[float] = []
    last = 1

    def train(image: object, settings: KernelGanSettings) -> EstimatedKernel:
        if len(trained) == last:
            raise KeyboardInterrupt
        trained.append(settings.zoom)
        return identity_kernel()

    arguments = (
        "validate", "--session", shaken, "--psf", psf, "--out", tmp_path / "v",
        "--models", "kernelgan", "--kernel-cache", tmp_path / "kernels", "--json",
    )  # fmt: skip
    monkeypatch.setattr(kernels, "estimate_kernel", train)
    monkeypatch.setattr(validation_run, "find_spec", lambda _: True)
    done = command(*arguments)
    assert done.status == 130
    assert "interrupted" in done.err
    assert len(list((tmp_path / "kernels").glob("*.npy"))) == 1
    last = 4
    done = command.done(*arguments)
    # Three pairs without the excluded capture: each zoom was trained for once.
    assert sorted(trained) == pytest.approx([1.2, 19 / 12, 1.9], abs=2e-3)
    command.done(*arguments, "--force")
    assert len(trained) == 3


def test_without_pytorch_the_learned_model_is_left_out_or_refused_by_name(
    command: Command, series: Path, psf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(validation_run, "find_spec", lambda _: None)
    assert "kernelgan" not in validation_run.default_models(Call("validate"))
    err = command.refused(
        1, f"validate --session {series} --psf {psf} --out {tmp_path / 'v'} --models kernelgan"
    )
    assert "pip install standoff[kernelgan], or leave them out with --models" in err
    assert not (tmp_path / "v").exists()


def test_what_cannot_be_read_or_written_is_one_line(
    command: Command, series: Path, psf: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way")
    for session, calibration, out, message in (
        (tmp_path, psf, tmp_path / "v", "is not a capture session"),
        (series, tmp_path / "none.json", tmp_path / "v", "none.json"),
        (series, psf, tmp_path / "file" / "v", "file is not a folder"),
    ):
        err = command.refused(
            1, f"validate --session {session} --psf {calibration} --out {out} --models paper"
        )
        assert message in err
        assert err.count("\n") == 1
