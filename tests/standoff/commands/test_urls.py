"""Photographs and results by URL, in this process's memory, beside the same in folders."""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import fsspec
import numpy as np
import pytest

from tests.standoff.conftest import Command

LAB = "memory://lab"


@pytest.fixture
def local(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three photographs in the working folder, the last one no image."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    rng = np.random.default_rng(1)
    for number in range(2):
        pixels = rng.integers(0, 255, (80, 90)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{number}.png"), pixels)
    (tmp_path / "psf.json").write_text(
        '{"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.8, "rho": 0.0}'
    )
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.fixture
def memory(local: Path) -> Iterator[fsspec.AbstractFileSystem]:
    system = fsspec.filesystem("memory")
    for path in local.iterdir():
        system.pipe_file(f"/lab/photographs/{path.name}", path.read_bytes())
    yield system
    system.rm("/lab", recursive=True)


CURVES = (
    "--model",
    "bicubic",
    "--zooms",
    "1,1.5",
    "--noise",
    "2",
    "--window",
    "9",
    "--signal-sigma",
    "1",
)


def without_provenance(text: bytes) -> object:
    document = json.loads(text)
    del document["provenance"]
    return document


def test_curves_by_url_are_those_of_the_folder(
    command: Command, local: Path, memory: fsspec.AbstractFileSystem
) -> None:
    command.done("detectability", local, *CURVES, "--out", "curves.json")
    words = ("detectability", f"{LAB}/photographs", *CURVES, "--out", f"{LAB}/results/far.json")
    done = command.done(*words)
    assert f"wrote {LAB}/results/far.json and {LAB}/results/far-noise.png" in done.out
    found, expected = memory.cat_file("/lab/results/far.json"), Path("curves.json").read_bytes()
    assert without_provenance(found) == without_provenance(expected)
    inputs = json.loads(found)["provenance"]["inputs"]
    assert [one["path"] for one in inputs] == [f"{LAB}/photographs/{n}.png" for n in (0, 1)]
    assert len(memory.ls("/lab/results")) == 5
    err = command.refused(1, *words)
    assert f"{LAB}/results/far.json exists already; --force replaces it" in err
    command.done(*words, "--force")


@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_pairs_by_url_are_those_of_the_folder(
    command: Command, local: Path, memory: fsspec.AbstractFileSystem, layout: str
) -> None:
    settings = ("--zoom", 2, "--crop", 32, "--test-fraction", 0, "--format", layout)
    words = ("--psf", "psf.json", *settings)
    command.done("sr-pairs", local, *words, "--out", "here")
    asked = ("sr-pairs", f"{LAB}/photographs", *words, "--out", f"{LAB}/far")
    done = command.done(*asked)
    copied = {
        name.removeprefix("/lab/far/"): memory.cat_file(name) for name in memory.find("/lab/far")
    }
    here = Path("here")
    if layout == "folder":
        expected = {
            path.relative_to(here).as_posix(): path.read_bytes()
            for path in here.rglob("*")
            if path.is_file() and path.parent.name != "shards"
        }
        del copied["dataset.json"], expected["dataset.json"]
        assert copied == expected
    else:
        assert sorted(copied) == [
            "dataset.json",
            "manifest.jsonl",
            "train-000000.tar",
            "train-000001.tar",
        ]
    assert "files were copied from far to memory://lab/far" in done.err
    assert ("2" if layout == "folder" else "4") + " files were copied" in command(*asked).err


def test_an_unknown_kind_of_url_is_one_line(command: Command, local: Path) -> None:
    for words in (("what://lab", "--out", "c.json"), (local, "--out", "what://lab/c.json")):
        err = command.refused(1, "detectability", *words, *CURVES)
        assert "unknown kind of URL, what://" in err
        assert err.count("\n") == 1


@pytest.mark.slow  # starts worker processes
def test_workers_do_not_see_the_memory_of_the_command_and_it_says_so(
    command: Command, memory: fsspec.AbstractFileSystem
) -> None:
    words = ("detectability", f"{LAB}/photographs", *CURVES, "--out", "curves.json")
    err = command.refused(1, *words, "--workers", 2)
    assert "memory:// is this process's own" in err
    assert err.count("\n") == 1


def test_a_table_of_the_curves_is_written_beside_them(
    command: Command, local: Path, memory: fsspec.AbstractFileSystem
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    words = ("detectability", local, *CURVES, "--parquet", "--out")
    command.done(*words, "curves.json")
    curves = json.loads(Path("curves.json").read_text())["curves"]
    table = parquet.read_table("curves.parquet").to_pylist()
    assert [(one["observer"], one["zoom"], one["dprime"]) for one in table] == [
        (curve["observer"], zoom, d_prime)
        for curve in curves
        for zoom, d_prime in zip(curve["zoom"], curve["dprime"], strict=True)
    ]
    command.done(*words, f"{LAB}/curves.json")
    assert memory.cat_file("/lab/curves.parquet") == Path("curves.parquet").read_bytes()
