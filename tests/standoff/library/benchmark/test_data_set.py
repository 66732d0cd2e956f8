"""The benchmark's data set: the same to the byte, resumable, never mixed with something else."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest

import standoff
from standoff.errors import ApplicationError
from standoff.library.benchmark import _data_set as data_set
from standoff.library.benchmark._data_set import STATE_NAME, file_facts
from tests.standoff.conftest import Command

LOCKED = {
    "numpy": "2.4.6",
    "scipy": "1.17.1",
    "opencv-contrib-python-headless": "5.0.0.93",
    "Pillow": "13.0.0",
}
TINY_SHA256 = "2ce0b4d0c7c9a69e54c97b1aebf5205580192e9a0d968a109e72f5e9687e9347"
"""What version 1.0 made with these; GalSim judges the light, closed forms judge the levels."""

PLAIN_PROCESSOR = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL",
    "NUMBA_CPU_NAME": "generic",
    "OPENBLAS_CORETYPE": "Prescott",
    "OPENCV_CPU_DISABLE": "AVX512F,AVX2,FP16,AVX,SSE4.2,SSE4.1,SSSE3",
    "JSIMD_FORCENONE": "1",
    # The first two are glibc's names before 2.33, the others those since.
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX2,-FMA,-AVX512F",
}
"""Switches vector instructions off in everything that chooses by the processor."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The smallest set, by two workers."""
    folder = tmp_path_factory.mktemp("benchmark") / "tiny"
    standoff.make_benchmark(folder, size="tiny", workers=2)
    return folder


def manifest(folder: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((folder / "manifest.json").read_text())
    return found


@pytest.mark.slow
def test_a_plain_processor_and_one_worker_make_the_same_bytes(tiny: Path, tmp_path: Path) -> None:
    out, cache = tmp_path / "plain", str(tmp_path / "compiled")
    words = [sys.executable, "-W", "error", "-m", "standoff", "benchmark", "make", "--json"]
    done = subprocess.run(
        [*words, "--out", out, "--size", "tiny"],
        env=os.environ | PLAIN_PROCESSOR | {"NUMBA_CACHE_DIR": cache},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout)["sha256"] == manifest(tiny)["sha256"]
    if all(version(name) == locked for name, locked in LOCKED.items()):
        assert manifest(tiny)["sha256"] == TINY_SHA256


@pytest.mark.slow
def test_the_manifest_lists_every_file_and_nothing_else_is_left(tiny: Path) -> None:
    files = {
        path.relative_to(tiny).as_posix(): file_facts(path.read_bytes())
        for path in tiny.rglob("*")
        if path.is_file() and path.name != "manifest.json"
    }
    assert manifest(tiny)["files"] == files
    assert not (tiny / STATE_NAME).exists()
    for track in ("psf", "simulation", "alignment", "changes", "things"):
        for task in json.loads((tiny / track / "tasks.json").read_text())["tasks"]:
            for key in ("file", "nearer_file", "reference", "followup", "chart"):
                if "chart" in task and key == "chart" and track == "psf":
                    continue  # its name
                if key in task:
                    assert task[key] in files


@pytest.mark.slow
def test_a_set_that_is_complete_is_found_so_and_one_that_was_altered_is_not(tiny: Path) -> None:
    again = standoff.make_benchmark(tiny, size="tiny")
    assert again.tasks_found_done == sum(again.tasks.values()) == 30
    with pytest.raises(ApplicationError, match="contains something else; name another --out"):
        standoff.make_benchmark(tiny, size="tiny", seed=2)
    card = tiny / "README.md"
    kept = card.read_bytes()
    card.write_bytes(b"# Mine\n")
    with pytest.raises(ApplicationError, match=r"README\.md is missing or has changed since"):
        standoff.make_benchmark(tiny, size="tiny")
    card.write_bytes(kept)


def rendered_tasks(out: Path) -> int:
    """Number of tasks that are committed."""
    segments = (out / STATE_NAME).glob("*.records")
    return sum(path.read_bytes().count(b"record/1 ") for path in segments)


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_was_and_makes_the_same_set(
    tiny: Path, tmp_path: Path
) -> None:
    out = tmp_path / "set"
    words = [sys.executable, "-m", "standoff", "benchmark", "make", "--size", "tiny"]
    with subprocess.Popen(
        [*words, "--out", out, "--workers", "2"], stderr=subprocess.PIPE, text=True
    ) as process:
        while rendered_tasks(out) < 3:
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert said.splitlines()[-1] == "standoff: interrupted; run the same command again"
    assert not (out / "manifest.json").exists()
    assert list(out.rglob("*.part*")) == []
    rendered = next(out.glob("*/*/*.tif"))
    rendered.write_bytes(bytes(rendered.stat().st_size))
    made = standoff.make_benchmark(out, size="tiny")
    assert 2 <= made.tasks_found_done < 20
    assert made.sha256 == manifest(tiny)["sha256"]


def test_a_folder_with_something_else_in_it_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ApplicationError, match="contains something else; name another --out"):
        standoff.make_benchmark(tmp_path, size="tiny")
    file = tmp_path / "thesis.txt"
    with pytest.raises(ApplicationError, match="contains something else"):
        standoff.make_benchmark(file, size="tiny")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    assert file.read_text() == "mine"


def test_a_folder_in_which_another_set_was_begun_is_refused(tmp_path: Path) -> None:
    state = tmp_path / STATE_NAME / "set.json"
    state.parent.mkdir()
    for begun in ('{"size": "full"}', "not JSON"):
        state.write_text(begun)
        with pytest.raises(ApplicationError, match="begun with another size or seed"):
            standoff.make_benchmark(tmp_path, size="tiny")


def test_a_set_that_an_earlier_version_began_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_set, "announced_sweep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        standoff.make_benchmark(tmp_path / "set", size="tiny")
    (tmp_path / "set" / STATE_NAME / "psf-leaves.json").write_text("{}")
    with pytest.raises(ApplicationError, match=r"set was begun by an earlier version.*remove it"):
        standoff.make_benchmark(tmp_path / "set", size="tiny")


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_full_disk_ends_the_command_with_one_line(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "set/psf/edges-001.tif")

    monkeypatch.setattr(data_set, "_write_below", full)
    done = command("benchmark", "make", "--size", "tiny", "--out", tmp_path / "set")
    assert done.status == 1
    assert done.err.splitlines()[-1] == (
        "standoff: cannot write set/psf/edges-001.tif: No space left on device; the same command "
        "goes on from here"
    )


@pytest.mark.parametrize("wrong", [{"size": "huge"}, {"seed": -1}, {"workers": 0}])
def test_there_are_three_sizes_and_no_negative_seeds(
    tmp_path: Path, wrong: dict[str, object]
) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        standoff.make_benchmark(tmp_path / "set", **{"size": "tiny", **wrong})  # type: ignore[arg-type]
    assert not (tmp_path / "set").exists()
