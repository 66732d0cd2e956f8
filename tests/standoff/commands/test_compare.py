import json
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from calibration.psf._document import PSF_SCHEMA
from standoff.terminal import _output as output
from tests.standoff.conftest import Command


def psf_file(path: Path, sigma_x_px: float, **values: object) -> Path:
    content = {
        "schema": PSF_SCHEMA,
        "sigma_x_px": sigma_x_px,
        "sigma_x_err_px": 0.002,
        "sigma_y_px": 0.7,
        "sigma_y_err_px": 0.002,
        **values,
    }
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_a_lens_that_moved_is_told_in_one_line(command: Command, tmp_path: Path) -> None:
    a, b = psf_file(tmp_path / "a.json", 0.80), psf_file(tmp_path / "b.json", 0.84)
    done = command.done("compare", a, b)
    assert "the PSF has changed: sigma_x_px by +5.00 %" in done.out
    # 1.96 times 0.002, and that times sqrt(2).
    assert "PSF, ± at 95 %" in done.out
    assert "0.8000 ± 0.0039" in done.out
    assert "0.0400 ± 0.0055" in done.out
    document = json.loads(command("compare", a, b, "--json").out)
    assert document["parameters"][0]["first_err"] == 0.002  # a standard error, as in psf.json
    assert document["is_changed"] is True
    x, y = document["parameters"]
    # 0.04 over an error of 0.002 sqrt(2)
    assert x["z"] == pytest.approx(14.142, rel=1e-3)
    assert y["is_changed"] is False


def test_the_same_calibration_has_not_changed(command: Command, tmp_path: Path) -> None:
    a = psf_file(tmp_path / "a.json", 0.80)
    done = command.done("compare", a, a)
    assert "no significant change in 2 parameters" in done.out


def test_different_methods_are_noted(command: Command, tmp_path: Path) -> None:
    a = psf_file(tmp_path / "a.json", 0.80, method="paper")
    b = psf_file(tmp_path / "b.json", 0.80, method="all-angles")
    assert "different methods: paper and all-angles" in command("compare", a, b).err


def test_files_without_errors_are_refused_by_name(command: Command, tmp_path: Path) -> None:
    a = psf_file(tmp_path / "a.json", 0.80)
    b = psf_file(tmp_path / "b.json", 0.80, sigma_x_err_px=None, sigma_y_err_px=None)
    err = command.refused(1, "compare", a, b)
    assert f"{a} and {b}: no width in common" in err
    assert "the second has no standard error of sigma_x_px, sigma_y_px" in err


def test_the_history_is_a_table_and_a_page(command: Command, tmp_path: Path) -> None:
    camera = {"camera": {"serial": "S9"}}
    (tmp_path / "s1" / "results").mkdir(parents=True)
    psf_file(
        tmp_path / "s1" / "results" / "psf.json",
        0.80,
        captured_utc="2025-01-02T03:04:05Z",
        **camera,
    )
    psf_file(tmp_path / "late.psf.json", 0.84, captured_utc="2025-02-02T03:04:05Z", **camera)
    (tmp_path / "broken-psf.json").write_text("{")
    page = tmp_path / "history.html"
    done = command.done("compare", "--history", tmp_path, "--report", page)
    assert "Camera S9, ± at 95 %" in done.out
    assert "left out:" in done.err
    assert "broken-psf.json" in done.err
    text = page.read_text()
    assert "Total widths over time" in text
    document = json.loads(command("compare", "--history", tmp_path, "--json").out)
    [known] = document["cameras"]
    assert [one["sigma_x_px"] for one in known["calibrations"]] == [0.80, 0.84]
    assert "the PSF has changed" in known["calibrations"][1]["change"]


def test_a_drift_stands_in_the_document_and_on_the_page_as_a_control_chart(
    command: Command, tmp_path: Path
) -> None:
    # The third time is 10:00 in UTC, the last states no offset; two calibrations have one time.
    times = (
        *("2025-01-02T03:04:05Z", "2025-02-02T03:04:05Z", "2025-03-02T12:00:00+02:00"),
        *("2025-03-02T10:00:00Z", "2025-05-02T03:04:05Z", "2025-06-02T03:04:05"),
    )
    for number, time in enumerate(times):
        for lens, grown in (("35 mm", 0.0), ("50 mm", 0.1 * (number > 2))):
            psf_file(
                tmp_path / f"{lens[:2]}-{number}.psf.json",
                0.80 + grown,
                captured_utc=time,
                camera={"serial": "S9"},
                labels={"lens": lens},
            )
    page = tmp_path / "history.html"
    command.done("compare", "--history", tmp_path, "--report", page)
    text = page.read_text()
    assert "Camera S9, 35 mm" in text
    assert "Control charts. Left:" in text
    still, moved = json.loads(command("compare", "--history", tmp_path, "--json").out)["cameras"]
    assert (still["serial"], still["lens"], moved["lens"]) == ("S9", "35 mm", "50 mm")
    assert [one["captured_utc"][:16] for one in moved["calibrations"]][2:] == [
        "2025-03-02T10:00", "2025-03-02T10:00", "2025-05-02T03:04", "2025-06-02T03:04",
    ]  # fmt: skip
    assert all(chart["drift"] is None for chart in still["control_charts"])
    [drift] = [one["drift"] for one in moved["control_charts"] if one["parameter"] == "sigma_x_px"]
    assert drift["change"] == pytest.approx(0.1, abs=3 * drift["change_err"])
    assert drift["before_utc"][:10] == "2025-03-02"


def test_a_time_that_is_none_is_refused_by_name(command: Command, tmp_path: Path) -> None:
    odd = psf_file(tmp_path / "odd.json", 0.80)
    document = json.loads(odd.read_text())
    odd.write_text(json.dumps(document | {"captured_utc": "last spring"}))
    err = command.refused(1, "compare", "--history", odd, odd)
    assert "odd.json" in err
    assert "expected a time in ISO 8601, got 'last spring'" in err


def test_a_folder_without_calibrations_is_named(command: Command, tmp_path: Path) -> None:
    assert f"no psf.json in {tmp_path}" in command.refused(1, "compare", "--history", tmp_path)


def test_a_history_of_files_is_a_table_alone(command: Command, tmp_path: Path) -> None:
    a, b = psf_file(tmp_path / "a.json", 0.80), psf_file(tmp_path / "b.json", 0.84)
    done = command.done("compare", "--history", a, b)
    assert "0.8000" in done.out
    assert "0.8400" in done.out
    assert "wrote" not in done.out
    (tmp_path / "broken.json").write_text("{")
    assert "broken.json" in command.refused(1, "compare", "--history", a, tmp_path / "broken.json")


@pytest.mark.parametrize("width", [80, 100, 10_000])
def test_a_history_is_no_wider_than_its_terminal_and_120_characters_in_a_pipe(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    # 10,000 is what the console of the results takes where there is no terminal.
    printed = StringIO()
    monkeypatch.setattr(
        output, "_RESULTS", Console(file=printed, width=width, soft_wrap=True, highlight=False)
    )
    folder = tmp_path / "a-folder-with-a-rather-long-name-of-which-nothing-is-to-be-lost"
    folder.mkdir()
    a = psf_file(folder / "a.json", 0.80, captured_utc="2025-01-02T03:04:05Z")
    b = psf_file(folder / "b.json", 0.84, captured_utc="2025-02-02T03:04:05Z")
    command.done("compare", "--history", a, b)
    lines = printed.getvalue().splitlines()
    assert max(map(len, lines)) <= min(width, 120)
    # Column by column, wrapped as it is, everything is there.
    rows = [line.split("│")[1:-1] for line in lines if line.startswith("│")]
    columns = ["".join(cell.strip() for cell in column) for column in zip(*rows, strict=True)]
    assert columns[0] == f"{a}{b}"
    assert columns[1].replace(" ", "") == "2025-01-0203:04:052025-02-0203:04:05"
    assert "0.8400 ±" in columns[2]
    change = json.loads(command("compare", "--history", a, b, "--json").out)
    [known] = change["cameras"]
    said = "".join(one["change"] or "first" for one in known["calibrations"])
    assert columns[5].replace(" ", "") == said.replace(" ", "")


def test_a_history_says_how_well_the_focus_repeats(command: Command, tmp_path: Path) -> None:
    a, b = psf_file(tmp_path / "a.json", 0.80), psf_file(tmp_path / "b.json", 0.84)
    told = command("compare", "--history", a, b).out
    assert "Focus scatter between 2 calibrations: 0.0231 ± 0.0129 px^2" in told
    (camera,) = json.loads(command("compare", "--history", a, b, "--json").out)["cameras"]
    # The mean variances are 0.0328 px^2 apart: their standard deviation is that over sqrt(2).
    assert camera["focus_scatter_px2"] == pytest.approx(0.0232, abs=2e-4)
    assert camera["focus_scatter_err_px2"] > 0.01
    (alone,) = json.loads(command("compare", "--history", a, "--json").out)["cameras"]
    assert alone["focus_scatter_px2"] is None


def test_null_widths_are_named_as_not_compared_or_end_the_command(
    command: Command, tmp_path: Path
) -> None:
    optical = {"optical_sigma_x_px": 0.7, "optical_sigma_x_err_px": 0.002}
    a = psf_file(tmp_path / "a.json", 0.80, **optical)
    b = psf_file(tmp_path / "b.json", 0.80, **optical, sigma_y_px=None)
    done = command.done("compare", a, b, "--json")
    assert done.err == "note: not compared: the second does not determine sigma_y_px\n"
    document = json.loads(done.out)
    assert document["remarks"] == ["not compared: the second does not determine sigma_y_px"]
    names = {one["name"] for one in document["parameters"]}
    assert names == {"sigma_x_px", "optical_sigma_x_px"}
    content = json.loads(b.read_text("utf-8")) | {"sigma_x_px": None}
    b.write_text(json.dumps(content), encoding="utf-8")
    done = command("compare", a, b)
    assert (done.status, done.out, done.err.count("\n")) == (1, "", 1)
    assert "the second does not determine sigma_x_px, sigma_y_px" in done.err
