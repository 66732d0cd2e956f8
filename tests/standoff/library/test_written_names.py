"""A file is never of another kind than its name says: such a name is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import standoff
from standoff.errors import ArgumentError

RNG = np.random.default_rng(1)
SCENE: NDArray[np.float64] = RNG.normal(500, 60, (64, 64))
PSF = standoff.GaussianPsf(sigma_px=0.7)
Writer = Callable[[str], object]


def simulated(**how: Any) -> Any:
    return standoff.simulate(SCENE, zoom=1.5, psf=PSF, **how)


WRITERS: dict[str, tuple[Writer, str, str]] = {
    "simulate": (lambda out: simulated().write(out), "x.png", "path"),
    "simulate, no suffix": (lambda out: simulated().write(out), "x", "path"),
    "uncertainty": (
        lambda out: simulated(uncertainty=standoff.UncertaintyOptions()).write_uncertainty(out),
        "x.jpg",
        "path",
    ),
    "write_psf": (
        lambda out: standoff.write_psf(out, standoff.read_psf("psf.json")),
        "p.csv",
        "path",
    ),
    "write_edge_table": (
        lambda out: standoff.write_edge_table(out, standoff.read_psf("psf.json")),
        "e.xlsx",
        "path",
    ),
    "write_noise": (
        lambda out: standoff.write_noise(out, standoff.measure_noise("flats")),
        "n.txt",
        "path",
    ),
    "write_geometry": (
        lambda out: standoff.write_geometry(out, standoff.calibrate_geometry("board")),
        "g.yaml",
        "path",
    ),
    "find_changes, report": (
        lambda out: standoff.find_changes("before.tif", "after.tif").write_report(out),
        "r.png",
        "path",
    ),
    "psf_history": (lambda out: standoff.psf_history("psf.json").write_report(out), "r.md", "path"),
    "calibrate_psf": (
        lambda out: standoff.calibrate_psf("vertical.tif", report=out),
        "r.docx",
        "report",
    ),
    "calibrate_geometry": (
        lambda out: standoff.calibrate_geometry("board", report=out),
        "r.png",
        "report",
    ),
    "measure_noise": (lambda out: standoff.measure_noise("flats", report=out), "r.png", "report"),
    "write_report": (lambda out: standoff.write_report("session", out), "r.txt", "out"),
    "export_session": (
        lambda out: standoff.export_session("session", out, format="ome-tiff"),
        "s.png",
        "out",
    ),
    "export_session, nexus": (
        lambda out: standoff.export_session("session", out, format="nexus"),
        "s.tif",
        "out",
    ),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_name_that_says_another_kind_of_file_is_refused_and_nothing_is_written(
    writer: str, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, name, argument = WRITERS[writer]
    monkeypatch.chdir(files)
    with pytest.raises(ArgumentError, match="must end in") as refused:
        write(str(tmp_path / name))
    assert refused.value.argument == argument
    assert not list(tmp_path.iterdir())


def test_the_names_that_are_written_hold_what_they_say(tmp_path: Path) -> None:
    for name, magic in (("x.tif", b"II*\0"), ("X.TIFF", b"II*\0")):
        simulated().write(tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(magic)
