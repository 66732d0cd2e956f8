"""The demo, and the tour of the README, command by command, on photographs of the demo."""

import json
import re
import shlex
import shutil
import subprocess
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import standoff
from simulation.arrays import FloatArray
from standoff.cli import run
from tests.standoff.conftest import Command

CHECKOUT = Path(__file__).parents[2]
TOUR = "## A tour of the commands"

NOT_RUN = {
    "make demo": "sets up an environment; what it then runs is the demo below",
    "make test": "sets up an environment, and is what runs this test",
}
"""Lines of the README outside the tour, with the reason why no test types them."""


DEMO = ("demo", "--set", "simulated.width_px=390", "--set", "simulated.height_px=290")


def tour_commands() -> list[str]:
    """The commands in the code blocks of the tour, in order."""
    text = (CHECKOUT / "README.md").read_text("utf-8")
    tour = text[text.index(TOUR) + len(TOUR) :].partition("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", tour, re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip()]


def python_blocks() -> list[str]:
    """The Python blocks of the README, in order."""
    text = (CHECKOUT / "README.md").read_text("utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with the photographs that the tour names, from a session of the demo.

    Both the demo and the tour's own session have a quarter of the pixels.
    """
    folder = tmp_path_factory.mktemp("tour")
    shutil.copytree(CHECKOUT / "configs", folder / "configs")
    bench = folder / "configs" / "simulated.toml"
    whole = bench.read_text("utf-8")
    small = whole.replace("width_px = 780", "width_px = 390").replace("px = 580", "px = 290")
    assert small.count("px = 390") == small.count("px = 290") == 1
    bench.write_text(small, "utf-8")
    demo = folder / "demo"
    printed = StringIO()
    with redirect_stdout(printed):
        assert run([*DEMO, "--out", str(demo), "--json"]) == 0
    (folder / "demo.json").write_text(printed.getvalue())
    captures = demo / "session" / "captures"
    for name, direction in (("vertical", "005"), ("horizontal", "095"), ("diagonal", "050")):
        shutil.copy(next(captures.glob(f"*_edge-{direction}_h0180*")), folder / f"edge-{name}.tif")
    scenes = sorted(captures.glob("*_texture-000_*"))
    (folder / "photographs").mkdir()
    for name, path in (
        ("near.tif", scenes[0]),
        ("before.tif", scenes[0]),
        ("after.tif", scenes[1]),
        ("photographs/1.tif", scenes[0]),
        ("photographs/2.tif", scenes[1]),
    ):
        shutil.copy(path, folder / name)
    chessboard = CHECKOUT / "tests" / "data" / "chessboards" / "left01.jpg"
    tifffile.imwrite(folder / "edges.tif", standoff.read_image(chessboard).grey_dn)
    (folder / "my_module.py").write_text(own_detector())
    focusing = "focus_distance_mm = 262.5\nf_number = 1.4\n"
    (folder / "my_bench.toml").write_text(small + focusing, "utf-8")
    return folder


@pytest.fixture(scope="module")
def printed_again(folder: Path) -> str:
    """What a second run of the demo prints for people, which finds the captures of the first."""
    compared = folder / "demo" / "session" / "results" / "validation.json"
    before = compared.stat().st_mtime_ns
    printed = StringIO()
    with redirect_stdout(printed):
        assert run([*DEMO, "--out", str(folder / "demo")]) == 0
    assert compared.stat().st_mtime_ns == before
    return printed.getvalue()


def own_detector() -> str:
    """The detector that the tour defines, as a module."""
    text = (CHECKOUT / "README.md").read_text("utf-8")
    (block,) = re.findall(r"```python\n(import .*?def detector.*?)\nfound = ", text, re.DOTALL)
    return str(block)


def test_the_tour_names_the_commands_it_tells_of() -> None:
    names = {shlex.split(line)[1] for line in tour_commands()}
    assert {"calibrate", "simulate", "sr-pairs", "capture", "verify", "report"} <= names
    assert {"geometry", "validate", "detectability", "limits", "pose", "changes"} <= names


def test_every_line_of_shell_is_in_the_tour_or_has_a_reason_not_to_run() -> None:
    text = (CHECKOUT / "README.md").read_text("utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    assert {line for line in lines if line.strip()} - set(tour_commands()) == NOT_RUN.keys()


@pytest.mark.slow(minutes=1)
def test_the_demo_measures_the_bench_and_predicts_its_captures(
    folder: Path, printed_again: str
) -> None:
    result = json.loads((folder / "demo.json").read_text())
    truth = {row["name"]: row for row in result["truth"]}
    for name in ("optical sigma_x / px", "optical sigma_y / px"):
        assert abs(truth[name]["relative_error"]) < 0.005
    for zoom in result["zooms"]:
        assert zoom["measured"] == pytest.approx(zoom["truth"], rel=3e-4)
    mse = result["mse"]
    assert mse["matched"] < mse["paper"]
    assert mse["paper"] * 5 < mse["bicubic"]
    page = Path(result["report"]).read_text()
    for title in ("Captures", "Point spread function", "Simulated against captured follow-ups"):
        assert title in page
    assert (folder / "demo" / "comparison.png").stat().st_size > 10_000
    assert "what could have been missed" in page
    assert "matched" in printed_again


@pytest.mark.slow
def test_the_demo_lists_the_one_thing_that_was_taken_away(folder: Path) -> None:
    (gone,) = json.loads((folder / "demo.json").read_text())["photographs"]["taken_away"]
    assert gone["what"] == "gone"


@pytest.mark.slow
def test_a_spot_of_the_demo_is_found_where_it_exceeds_what_is_needed(folder: Path) -> None:
    found = json.loads((folder / "demo.json").read_text())["photographs"]
    assert found["changes_unpainted"] == 0
    assert [one["is_found"] for one in found["spots"]] == [True, False]
    for spot in found["spots"]:
        assert spot["is_found"] == (spot["amplitude_dn"] > spot["needed_dn"])


def srgb_to_linear(levels: FloatArray) -> FloatArray:
    """IEC 61966-2-1, 5.2, of 8-bit levels, to a white of 255."""
    v = levels / 255
    return np.asarray(255 * np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


@pytest.mark.slow
def test_the_spots_are_all_that_was_painted_into_the_demos_photograph(folder: Path) -> None:
    spots = json.loads((folder / "demo.json").read_text())["photographs"]["spots"]
    painted, original = (
        np.asarray(Image.open(path), dtype=np.float64)
        for path in (
            folder / "demo" / "photographs" / "after.png",
            standoff.example_photographs().further,
        )
    )
    y, x = np.indices(painted.shape[:2])
    near = np.zeros(painted.shape[:2], dtype=bool)
    for spot in spots:
        distance_px = np.hypot(x - spot["x_px"], y - spot["y_px"])
        near |= distance_px < 6 * spot["sigma_px"]
        place = painted[spot["y_px"], spot["x_px"]], original[spot["y_px"], spot["x_px"]]
        added_dn = srgb_to_linear(place[0]) - srgb_to_linear(place[1])
        # Half a stored level is at most 1.2 DN of linear light near white.
        assert added_dn == pytest.approx(spot["amplitude_dn"], abs=2.3)
    assert np.array_equal(painted[~near], original[~near])


@pytest.mark.slow
def test_what_the_demo_says_to_try_next_works_as_it_is_printed(
    command: Command, printed_again: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [
        line.strip()
        for line in printed_again[printed_again.index("What to try next") :].splitlines()[1:]
        if line.strip() and not line.strip().startswith("#")
    ]
    assert [line.split(" standoff ")[1].split()[0] for line in lines] == [
        "changes", "calibrate", "simulate", "detectability", "mock", "console",
    ]  # fmt: skip
    done = subprocess.run(
        shlex.split(lines[0]), cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{lines[0]}: {done.stderr}"
    # The same program in this process; the last two serve until Ctrl-C: test_mock, test_console.
    monkeypatch.chdir(CHECKOUT)
    started = lines[0].partition(" standoff ")[0]
    for line in lines[1:4]:
        starts, _, arguments = line.partition(" standoff ")
        assert starts == started
        command.done(*shlex.split(arguments))


@pytest.mark.slow(minutes=1.5)
def test_every_command_of_the_tour_runs_as_it_is_written(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    for line in tour_commands():
        program, *arguments = shlex.split(line)
        assert program == "standoff"
        command.done(*arguments)


@pytest.mark.slow(minutes=0.5)
@pytest.mark.parametrize("place", range(3))
def test_every_block_of_python_runs_as_it_is_written(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: int
) -> None:
    blocks = python_blocks()
    assert len(blocks) == 3
    for name in ("edges.tif", "near.tif", "before.tif", "after.tif", "my_bench.toml"):
        shutil.copy(folder / name, tmp_path / name)
    shutil.copytree(folder / "photographs", tmp_path / "photographs")
    shutil.copy(folder / "demo" / "session" / "results" / "psf.json", tmp_path / "psf.json")
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks[place], "README.md", "exec"), {"__name__": "__main__"})
