"""Who a report is for, and what was measured, as people call it."""

import json
from pathlib import Path

import pytest

import standoff
from calibration.psf import PsfCalibration
from standoff.errors import ArgumentError
from tests.analysis.html_page import Page
from tests.standoff.conftest import SMALL_BENCH, Command

LABELS = {
    "lens": "50 mm f/1.8 no. 7",
    "camera": "prototype B <2>",
    "target": "slanted edge, chrome on glass",
    "customer": "Müller & Söhne",
}
OF_BENCH = """
[labels]
lens = "bench lens"
customer = "bench customer"
"""


def bench(folder: Path, *, labels: str = OF_BENCH) -> Path:
    path = folder / "bench.toml"
    path.write_text(SMALL_BENCH + labels)
    return path


def document(path: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads(path.read_text("utf-8"))
    return found


def test_labels_stand_on_the_first_page_and_in_psf_json(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    out, page = tmp_path / "psf.json", tmp_path / "psf.html"
    words = [word for name, text in LABELS.items()
             for word in (f"--{'chart' if name == 'target' else name}", text)]  # fmt: skip
    command.done("calibrate", edge_file, "--out", out, "--report", page, *words)
    assert document(out)["labels"] == LABELS
    assert standoff.read_psf(out).labels == LABELS
    shown = Page(page.read_text("utf-8")).text
    for text in LABELS.values():
        assert text in shown
    assert "prototype B <2>" not in page.read_text("utf-8")  # escaped


def test_without_labels_the_report_names_no_customer(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    out, page = tmp_path / "psf.json", tmp_path / "psf.html"
    command.done("calibrate", edge_file, "--out", out, "--report", page)
    assert document(out)["labels"] is None
    assert "customer" not in Page(page.read_text("utf-8")).text


def test_a_bench_file_states_labels_and_pitch_and_the_caller_comes_first(
    edge_file: Path, tmp_path: Path
) -> None:
    stated = bench(tmp_path)
    pitch_um = float(
        next(line for line in stated.read_text().splitlines() if "pixel_pitch_um" in line)
        .split("=")[1]
    )  # fmt: skip
    psf = standoff.calibrate_psf(edge_file, bench=stated)
    assert psf.labels == {"lens": "bench lens", "customer": "bench customer"}
    assert (psf.pixel_pitch_um, psf.pixel_pitch_from) == (pitch_um, "the bench file")
    first = standoff.calibrate_psf(
        edge_file, bench=stated, labels={"customer": "other"}, pixel_pitch_um=5.0
    )
    assert first.labels == {"lens": "bench lens", "customer": "other"}
    assert first.pixel_pitch_um == 5.0


@pytest.mark.parametrize(
    ("labels", "said"),
    [
        ({"costumer": "x"}, "customer was probably meant"),
        ({"lens": ""}, "a text of 1 to 200 letters"),
        ({"lens": "x" * 201}, "a text of 1 to 200 letters"),
        ({"lens": 50}, "lens is a text"),
    ],
)
def test_a_label_that_cannot_be_is_refused(
    edge_file: Path, labels: dict[str, str], said: str
) -> None:
    with pytest.raises(ArgumentError, match=said) as refused:
        standoff.calibrate_psf(edge_file, labels=labels)
    assert refused.value.argument == "labels"


def test_files_of_before_have_no_labels() -> None:
    assert PsfCalibration.model_validate({"sigma_x_px": 0.7}).labels is None
