"""What is there already is never replaced silently: every command that writes is walked over."""

import inspect
from pathlib import Path

import pytest
import tifffile

from acquisition.files import written_together
from calibration.noise import map_paths
from standoff.errors import ApplicationError
from standoff.library import CHANGE_FILES, DEMO_FILES, FILES_OF_SERIES, VALIDATION_FILES
from standoff.library.evaluation import evaluation_figure_paths
from standoff.library.measured_curves import curve_figure_paths
from standoff.terminal._app import COMMANDS, _imported
from tests.standoff.conftest import Command

CURVES = ("--curves", "c.json", "--min-dprime", "2")
BEHIND_A_CAMERA = ("--focal-length-px", "964", "--image-size", "780x580")
WRITERS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "demo": (("--out", "d"), tuple(f"d/{name}" for name in DEMO_FILES)),
    "calibrate": (
        ("a.tif", "--out", "p.json", "--csv", "e.csv", "--report", "r.html"),
        ("p.json", "e.csv", "r.html"),
    ),
    "compare": (("--history", "a.json", "--report", "r.html"), ("r.html",)),
    "export": (("s", "--format", "ome-tiff", "--out", "s.ome.tif"), ("s.ome.tif",)),
    "focus": (("--bench", "b.toml", "--sweep", "--out", "f.png"), ("f.png",)),
    "geometry": (
        ("--session", "s", "--out", "g.json", "--report", "r.html"),
        ("g.json", "r.html"),
    ),
    "noise": (
        ("--session", "s", "--out", "n.json", "--report", "r.html"),
        ("n.json", *(path.name for path in map_paths(Path("n.json")).values()), "r.html"),
    ),
    "simulate": (
        (
            "a.tif",
            "--homography",
            "H.json",
            "--psf",
            "p.json",
            "--out",
            "f.tif",
            "--nearer",
            "m.png",
        ),
        ("f.tif", "m.png"),
    ),
    "detectability": (
        ("a.tif", "--model", "bicubic", "--out", "c.json"),
        ("c.json", *(path.name for path in curve_figure_paths(Path("c.json")))),
    ),
    "evaluate": (
        (
            *("ssim", "--photographs", "a.tif", "--model", "bicubic", "--out", "e.json"),
            *("--report", "r.html"),
        ),
        ("e.json", *(path.name for path in evaluation_figure_paths(Path("e.json"))), "r.html"),
    ),
    "plan-study": (
        ("--bench", "b.toml", "--plan", "p.toml", "--psf", "p.json", "--out", "s.json"),
        ("s.json",),
    ),
    "limits": ((*CURVES, *BEHIND_A_CAMERA, "--plot", "l.svg"), ("l.svg",)),
    "pose": (("a.tif", "b.tif", *CURVES, "--picture", "p.png"), ("p.png",)),
    "changes": (
        ("a.tif", "b.tif", "--out", "d", "--report", "r.html"),
        ("r.html", *(f"d/{name}" for name in CHANGE_FILES)),
    ),
    "validate": (
        ("--session", "s", "--psf", "p.json", "--out", "d"),
        tuple(f"d/{name}" for name in VALIDATION_FILES),
    ),
    "paper": (("--out", "d"), tuple(f"d/{name}" for name in VALIDATION_FILES)),
    "lens": (("a.tif", "--out", "l.html"), ("l.html", "l.csv", "l.json")),
    "report": (("s", "--out", "r.html"), ("r.html",)),
}
"""Of every command that writes results: a command line, and the files that it would write.

It reads no file that exists: a refusal comes before anything is read.
"""

RESUMED = {"capture", "change-pairs", "guide", "import", "sr-pairs"}
"""Commands whose --out is a folder that a second run goes on with."""

OPTIONS = {"out", "csv", "report", "nearer", "plot", "picture"}
"""Names of all options that say where a result goes."""


def test_every_command_that_writes_is_walked_over() -> None:
    parameters = {
        name: set(inspect.signature(function).parameters)
        for name, path in COMMANDS.items()
        if inspect.isfunction(function := _imported(path))
    }
    assert {name for name, one in parameters.items() if one & OPTIONS} == {*WRITERS, *RESUMED}
    for name, (words, _) in WRITERS.items():
        assert "force" in parameters[name]
        given = {word.removeprefix("--") for word in words}
        assert given >= parameters[name] & OPTIONS - ({"out"} if name == "pose" else set())


@pytest.mark.parametrize(
    ("name", "file"), [(name, file) for name, (_, files) in WRITERS.items() for file in files]
)
def test_a_result_that_is_there_is_refused_before_anything_is_read(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, file: str
) -> None:
    monkeypatch.chdir(tmp_path)
    there = Path(file)
    there.parent.mkdir(parents=True, exist_ok=True)
    there.write_bytes(b"of before")
    done = command(name, *WRITERS[name][0])
    assert (done.status, done.out) == (1, "")
    assert done.err == (
        f"standoff: {file} exists already; --force replaces it, or name another file\n"
    )
    assert there.read_bytes() == b"of before"
    assert [path for path in Path().rglob("*") if path.is_file()] == [there]


def test_with_force_it_is_replaced_and_an_input_never_is(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "far.tif"
    words = ("simulate", image_file, "--zoom", 2, "--model", "bicubic", "--out")
    command.done(*words, out)
    first = out.read_bytes()
    assert command(*words, out).status == 1
    assert out.read_bytes() == first
    command.done(*words, out, "--exposure", 0.5, "--force")
    assert tifffile.imread(out).mean() * 2 == pytest.approx(2000, rel=0.05)  # of levels 0 to 4000
    read = image_file.read_bytes()
    assert command(*words, image_file, "--force").status == 2
    assert image_file.read_bytes() == read


def test_a_folder_and_a_device_are_no_result_to_replace(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "far.tif").mkdir()
    words = ("simulate", image_file, "--zoom", 2, "--model", "bicubic", "--force", "--out")
    done = command(*words, tmp_path / "far.tif")
    assert (done.status, "far.tif: it is a folder" in done.err) == (1, True)
    done = command("calibrate", image_file, "--force", "--out", "/dev/null")
    assert (done.status, "/dev/null: it is not a regular file" in done.err) == (1, True)
    assert not Path("/dev/null").is_file()


def test_a_series_goes_on_in_its_own_folder_and_in_no_other(
    command: Command, tmp_path: Path
) -> None:
    images = [tmp_path / name for name in ("a.tif", "b.tif", "c.tif")]
    for name in FILES_OF_SERIES:
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_bytes(b"of before")
    done = command("changes", *images, "--out", tmp_path / "out")
    assert (done.status, "summary.json exists already; --force" in done.err) == (1, True)
    (tmp_path / "out" / "followups.sweep").mkdir()
    (tmp_path / "out" / "poses.csv").touch()  # of a series, but of poses
    done = command("changes", *images, "--out", tmp_path / "out")
    assert (done.status, "summary.json exists already; --force" in done.err) == (1, True)
    (tmp_path / "out" / "poses.csv").unlink()
    done = command("changes", *images, "--out", tmp_path / "out")
    assert (done.status, "exists already" in done.err) == (1, False)  # a.tif cannot be read


def test_what_fails_halfway_leaves_the_earlier_result_whole(tmp_path: Path) -> None:
    document, other = tmp_path / "noise.json", tmp_path / "noise_dark.tif"
    document.write_text("old")
    other.write_text("old")
    with pytest.raises(ZeroDivisionError), written_together(document) as folder:  # noqa: PT012 - two steps of one write
        (folder / other.name).write_text("new")
        raise ZeroDivisionError
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "noise.json": "old",
        "noise_dark.tif": "old",
    }


def test_files_of_one_result_are_replaced_together_the_document_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document, other = tmp_path / "a.json", tmp_path / "z.tif"
    document.write_text("old")
    other.write_text("old")
    (tmp_path / ".a.json.part").mkdir()  # of a run that was killed
    (tmp_path / ".a.json.part" / "left.tif").touch()
    seen = []
    replace = Path.replace

    def watched(path: Path, target: Path) -> Path:
        seen.append((target.name, document.exists()))
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", watched)
    with written_together(document) as folder:
        (folder / document.name).write_text("new")
        (folder / other.name).write_text("new")
    # At no time does the old document stand beside new files.
    assert seen == [("z.tif", False), ("a.json", False)]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "a.json": "new",
        "z.tif": "new",
    }


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "folder").write_text("a file")
    with (
        pytest.raises(ApplicationError, match="cannot"),
        written_together(tmp_path / "folder" / "a.json"),
    ):
        pass
