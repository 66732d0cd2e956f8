"""A camera whose description would take Aravis down: one line, status 1, by every command."""

import json
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_mocks.practice_bench import PracticeBench
from tests.acquisition.aravis.description_texts import with_width
from tests.acquisition.aravis_bench import needs_aravis
from tests.hil_mocks.gige_bench import gige_bench
from tests.hil_mocks.gige_client import wait_for
from tests.standoff.conftest import Command
from tests.standoff.console.processes import first_line, standoff_process

pytestmark = needs_aravis

PLAN = """
schema = "standoff.plan/1"
name = "one capture"
heights_mm = [100.0]
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0]
"""


def aravis_bench_file(folder: Path, address: str, *lines: str) -> Path:
    """The bench file of a camera at an address and a stage that is moved by hand."""
    path = folder / "bench.toml"
    path.write_text(
        "\n".join(
            [
                "[camera]",
                'driver = "aravis"',
                f'address = "{address}"',
                'pixel_format = "Mono12"',
                "exposure_us = 4000.0",
                "gain_db = 0.0",
                *(lines or ("frame_rate_hz = 60.0",)),
                "[stage]",
                'driver = "manual"',
                "limits_mm = [0.0, 300.0]",
                "[optics]",
                "focal_length_mm = 8.0",
                "pixel_pitch_um = 8.3",
            ]
        )
    )
    return path


@pytest.fixture
def circular() -> Iterator[PracticeBench]:
    """A camera whose width is the value of its height, which is that of its width."""
    with gige_bench() as bench:
        text = with_width("<pValue>Height</pValue>")
        bench.camera.serve_description(
            text.replace(b"<pValue>HeightReg</pValue>", b"<pValue>Width</pValue>")
        )
        yield bench


@pytest.mark.slow
@pytest.mark.parametrize("name", ["capture", "focus", "doctor"])
def test_a_description_that_refers_to_itself_is_one_line_and_status_1(
    circular: PracticeBench, process: Command, tmp_path: Path, name: str
) -> None:
    bench = aravis_bench_file(tmp_path, circular.camera.address)
    (tmp_path / "plan.toml").write_text(PLAN)
    answers = tmp_path / "answers"
    answers.write_text("\n" * 4)
    out = tmp_path / "session"
    words = {
        "capture": ("--plan", tmp_path / "plan.toml", "--out", out, "--answers", answers),
        "focus": ("--readings", 2),
        "doctor": ("--json",),
    }[name]
    done = process(name, "--bench", bench, *words)
    assert done.status == 1
    if name == "doctor":
        checks = {check["name"]: check for check in json.loads(done.out)["checks"]}
        found = checks["camera"]["found"]
        assert "firmware" in checks["camera"]["remedy"]
        assert "cable" not in checks["camera"]["remedy"]
    else:
        [found] = [line for line in done.err.splitlines() if line.startswith("standoff:")]
        assert done.err.strip().endswith(found)
    assert circular.camera.address in found
    assert "refers to itself (Height -> Width -> Height)" in found or (
        "refers to itself (Width -> Height -> Width)" in found
    )
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.waits
def test_the_console_says_so_on_its_doctor_page_and_stays_up(
    circular: PracticeBench, tmp_path: Path
) -> None:
    pytest.importorskip("starlette", reason="the console's extra is not installed")
    bench = aravis_bench_file(tmp_path, circular.camera.address)
    with standoff_process("console", "--bench", bench, "--port", 0, "--json", cwd=tmp_path) as it:
        url = first_line(it)["url"].rstrip("/")

        def page() -> str:
            with urllib.request.urlopen(f"{url}/doctor", timeout=20) as answer:
                return str(answer.read().decode())

        wait_for(lambda: "refers to itself" in page())
        assert "Reinstall the maker&#39;s firmware in the camera" in page()
        assert it.poll() is None
