import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from acquisition.session._reader import Session
from tests.standoff.conftest import Command


def test_photographs_become_a_session_that_calibrates(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "s"
    clean = tifffile.imread(edge_file)
    noise = np.random.default_rng(5).normal(0.0, 100.0, clean.shape)
    tifffile.imwrite(edge_file, np.rint(clean + noise).astype(np.uint16))
    words = ("import", edge_file, "--kind", "edge", "--height-mm", 250, "--scale", 12.5)
    done = json.loads(command(*words, "--out", out, "--json").out)
    assert (done["imported"], done["photographs"]) == (1, 1)
    [record] = Session(out).records
    assert (record.height_mm, record.scale_px_per_mm, record.frames_used) == (250.0, 12.5, 1)
    np.testing.assert_array_equal(
        Session(out).load(record).mean_dn, tifffile.imread(edge_file).astype(np.float32)
    )
    command.done("verify", out)
    psf = tmp_path / "psf.json"
    command.done("calibrate", "--session", out, "--out", psf)
    # As the photograph itself: total sigma 0.8 px across the vertical edge.
    assert json.loads(psf.read_text())["sigma_x_px"] == pytest.approx(0.8, rel=0.01)
    assert json.loads(command(*words, "--out", out, "--json").out)["imported"] == 0


def test_an_encoded_photograph_is_made_linear_and_grey(command: Command, tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    Image.fromarray(np.full((20, 30, 3), 188, np.uint8)).save(path)
    words = ("import", path, "--kind", "texture", "--height-mm", 0, "--srgb")
    command.done(*words, "--out", tmp_path / "s")
    session = Session(tmp_path / "s")
    mean_dn = session.load(session.records[0]).mean_dn
    # IEC 61966-2-1: ((188 / 255 + 0.055) / 1.055)^2.4 = 0.50289 of 255.
    np.testing.assert_allclose(mean_dn, 128.236, rtol=1e-4)


@pytest.mark.parametrize(
    ("words", "status", "fault"),
    [
        (["absent.tif", "--kind", "edge", "--height-mm", "9"], 1, "absent.tif"),
        (
            ["edge.tif", "edge.tif", "--kind", "edge", "--height-mm", "9"],
            1,
            "two photographs are named edge.tif",
        ),
        (["edge.tif", "--kind", "lens"], 2, "kind"),
        (["edge.tif", "--kind", "edge", "--height-mm", "9", "--scale", "0"], 2, "--scale"),
        (["edge.tif", "--kind", "edge", "--height-mm", "nan"], 2, "--height-mm"),
        (["edge.tif", "--height-mm", "9"], 2, "--kind"),
        # A height that nobody gave would stay in the session for ever.
        (["edge.tif", "--kind", "edge"], 2, "--height-mm"),
    ],
)
def test_what_cannot_be_imported_is_one_line_and_writes_nothing(
    command: Command,
    edge_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    status: int,
    fault: str,
) -> None:
    monkeypatch.chdir(edge_file.parent)
    done = command("import", *words, "--out", tmp_path / "s")
    assert (done.status, done.out) == (status, "")
    assert done.err.count("\n") == 1
    assert fault in done.err
    assert not (tmp_path / "s").exists()


def test_another_import_does_not_go_into_the_same_session(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    words = ("import", edge_file, "--kind", "edge", "--out", tmp_path / "s", "--height-mm")
    command.done(*words, 100)
    err = command.refused(1, *words, 200)
    assert "made with other settings" in err
    assert "heights_mm.0 was 100.0, now 200.0" in err
    assert "use a new directory" in err


def test_a_float_photograph_tells_no_level_at_which_it_clips(
    command: Command, tmp_path: Path
) -> None:
    levels = np.linspace(0.0, 0.75, 600, dtype=np.float32).reshape(20, 30)
    tifffile.imwrite(tmp_path / "float.tif", levels)
    words = ("import", tmp_path / "float.tif", "--kind", "texture", "--height-mm", 9)
    done = command.done(*words, "--out", tmp_path / "s")
    assert done.out == f"{tmp_path / 's'}: 1 of 1 photographs imported\n"
    [record] = Session(tmp_path / "s").records
    assert record.saturated_pixels == 0
    assert record.max_level_dn > 0.75


def test_a_wrong_height_is_corrected_in_place(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.tif"
    other.write_bytes(edge_file.read_bytes())
    out = tmp_path / "s"
    words = ("import", edge_file, other, "--kind", "edge", "--height-mm", 0, "--out", out)
    command.done(*words)
    files = {path: path.read_bytes() for path in (out / "captures").iterdir()}
    correct = ("session", "set-height", 1, out, "--reason", "wrong scale", "--operator", "Ada")
    command.done(*correct, "--height-mm", 260)
    done = command(*correct, "--height-mm", 250.5)
    assert done.out == f"{out}: capture 1 is at 250.5 mm (was 260 mm): wrong scale\n"
    # The first capture stays, what was recorded is told, and nothing but the journal has grown.
    assert [record.height_mm for record in Session(out).records] == [0.0, 250.5]
    shown = json.loads(command("session", "show", out, "--json").out)["captures"]
    heights = [(one["height_mm"], one["uncorrected_height_mm"]) for one in shown]
    assert heights == [(0.0, None), (250.5, 0.0)]
    assert "250.500  " in (listing := command("session", "show", out).out).replace("│", " ")
    assert "recorded at 0.000 mm" in listing
    assert files == {path: path.read_bytes() for path in (out / "captures").iterdir()}
    command.done("verify", out)
    # Used by what comes after, and the import goes on as before.
    psf = tmp_path / "psf.json"
    command.done("calibrate", "--session", out, "--out", psf)
    edges = json.loads(psf.read_text())["edges"]
    assert sorted(edge["height_mm"] for edge in edges) == [0.0, 250.5]
    command.done(*words, "--json")
    assert [record.height_mm for record in Session(out).records] == [0.0, 250.5]


def test_several_heights_are_corrected_or_none(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.tif"
    other.write_bytes(edge_file.read_bytes())
    out = tmp_path / "s"
    words = ("import", edge_file, other, "--kind", "edge", "--height-mm", 0, "--out", out)
    command.done(*words)
    given = ("--height-mm", 9, "--reason", "r")
    refused = command("session", "set-height", 0, 2, out, *given)
    assert (refused.status, "no capture with index 2" in refused.err) == (1, True)
    assert [record.height_mm for record in Session(out).records] == [0.0, 0.0]
    command.done("session", "set-height", 0, 1, out, *given)
    assert [record.height_mm for record in Session(out).records] == [9.0, 9.0]
    assert command("session", "set-height", 0, out, "--height-mm", "nan").status == 2
    # After a repair, too.
    (out / "journal.head").unlink()
    command.done("verify", "--repair", out)
    assert [record.height_mm for record in Session(out).records] == [9.0, 9.0]


def test_a_height_that_a_stage_read_back_is_not_corrected(
    command: Command, session_dir: Path
) -> None:
    before = [record.height_mm for record in Session(session_dir).records]
    done = command("session", "set-height", 0, session_dir, "--height-mm", 9, "--reason", "r")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "exclude a capture whose height is wrong, or retake it" in done.err
    assert [record.height_mm for record in Session(session_dir).records] == before
