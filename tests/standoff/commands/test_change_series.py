"""`standoff changes` with a folder of follow-ups."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from analysis.change_series import read_changes_series, read_time_line
from analysis.changes._document import read_changes
from standoff.cli import run
from standoff.library.changes import compared as compare
from standoff.library.series import _change_work as change_work
from tests.standoff.changed_photographs import changed_pair, write_levels, write_psf
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

pytestmark = pytest.mark.slow

FILES = (
    *("changes-figure.png", "changes.csv", "changes.json", "changes.png", "compared.png"),
    *("difference.tif", "limit.tif", "plain-difference.tif", "pose-difference.tif", "report.html"),
    *("significance.tif", "uncertainty.tif"),
)
WITH_PROVENANCE = ("changes.json", "report.html")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of a reference and two follow-ups, a PSF, and what each gives alone."""
    root = tmp_path_factory.mktemp("made")
    photographs = root / "photographs"
    photographs.mkdir()
    write_levels(photographs / "near.tif", changed_pair(2, 25.0).reference)
    for name, contrast_dn in (("same", 0.0), ("other", 25.0)):
        write_levels(photographs / f"{name}.tif", changed_pair(2, contrast_dn).followup)
    write_psf(root / "psf.json")
    for name in ("same", "other"):
        far = photographs / f"{name}.tif"
        words = [*asked(root, far), "--out", root / "alone" / name]
        assert run([str(word) for word in words]) == 0
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    """A copy to change; times of files are kept."""
    return Path(shutil.copytree(made, tmp_path / "root"))


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the follow-ups that are compared, as they are."""
    names: list[str] = []

    def listing(*arguments: Any) -> Any:
        names.append(arguments[1].path.name)
        return compare(*arguments)

    monkeypatch.setattr(f"{change_work.__name__}.compared", listing)
    return names


def asked(root: Path, *followups: Path) -> tuple[object, ...]:
    near = root / "photographs" / "near.tif"
    return ("changes", near, *followups, "--psf", root / "psf.json")


def pixels(folder: Path) -> dict[str, bytes]:
    named = (name for name in FILES if name not in WITH_PROVENANCE)
    return {name: (folder / name).read_bytes() for name in named}


def test_each_of_a_folder_gets_what_it_gets_alone(command: Command, root: Path) -> None:
    photographs, out = root / "photographs", root / "out"
    done = command.done(*asked(root, photographs), "--out", out)
    assert f"2 follow-ups compared, 1 with changed pixels (0 already done); wrote {out}" in done.out
    series = read_changes_series(out / "summary.json")
    assert (series.compared, series.changed, series.refused) == (2, 1, 0)
    assert [one.folder for one in series.followups] == ["other", "same"]
    for listed in series.followups:
        assert listed.folder is not None
        folder, alone = out / listed.folder, root / "alone" / listed.folder
        assert sorted(path.name for path in folder.iterdir()) == list(FILES)
        assert pixels(folder) == pixels(alone)
        found, expected = (
            read_changes(folder / "changes.json"),
            read_changes(alone / "changes.json"),
        )
        names = {"reference", "followup", "provenance"}
        assert found.model_dump(exclude=names) == expected.model_dump(exclude=names)
        followup = photographs / f"{listed.folder}.tif"
        assert listed.followup == found.followup == str(followup)
        assert found.reference == str(photographs / "near.tif")
        for key in ("changed_px", "compared_px", "zoom", "threshold_sd"):
            assert getattr(listed, key) == getattr(expected, key)
        document = json.loads((folder / "changes.json").read_text("utf-8"))
        own = (root / "psf.json", photographs / "near.tif", followup)
        assert_provenance(document, "changes", *own)
    with (out / "changes.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [(line["folder"], line["changed_px"]) for line in lines] == [
        (one.folder, str(one.changed_px)) for one in series.followups
    ]


def test_nothing_is_compared_twice_unless_it_is_gone(
    command: Command, root: Path, compared: list[str]
) -> None:
    photographs, out = root / "photographs", root / "out"
    first = command(*asked(root, photographs), "--out", out, "--json")
    assert sorted(compared) == ["other.tif", "same.tif"]
    compared.clear()
    again = command(*asked(root, photographs), "--out", out, "--json")
    assert compared == []
    documents = [json.loads(one.out) for one in (first, again)]
    assert documents[0]["followups"] == documents[1]["followups"]
    (out / "same" / "difference.tif").unlink()
    command.done(*asked(root, photographs), "--out", out)
    assert compared == ["same.tif"]
    assert pixels(out / "same") == pixels(root / "alone" / "same")


def test_maps_of_two_settings_are_never_taken_for_one_comparison(
    command: Command, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photographs, out = root / "photographs", root / "out"
    command.done(*asked(root, photographs), "--out", out)

    def interrupted(folder: Path, *_: Any) -> None:
        # Of the same size, as maps of one frame are.
        (folder / "difference.tif").write_bytes((folder / "uncertainty.tif").read_bytes())
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(f"{change_work.__name__}.write_changes", interrupted)
        others = ("--false-alarms", 5, "--out", out)
        assert command(*asked(root, photographs), *others).status == 130
    assert not (out / "summary.json").exists()
    done = command(*asked(root, photographs), "--out", out)
    assert "(1 already done)" in done.out
    for name in ("same", "other"):
        assert pixels(out / name) == pixels(root / "alone" / name)


def test_a_follow_up_that_gives_nothing_is_listed_and_leaves_nothing_of_before(
    command: Command, root: Path
) -> None:
    photographs, out = root / "photographs", root / "out"
    command.done(*asked(root, photographs), "--out", out)
    (photographs / "same.tif").write_bytes((photographs / "same.tif").read_bytes()[:5000])
    shutil.copy(root / "psf.json", photographs / "text.png")
    err = command.refused(1, *asked(root, photographs), "--out", out)
    assert err.splitlines()[-1] == (
        "standoff: 2 of 3 follow-ups gave nothing; the results of the others are complete"
    )
    series = read_changes_series(out / "summary.json")
    refused = {Path(one.followup).name: one.refused for one in series.followups if one.refused}
    assert set(refused) == {"same.tif", "text.png"}
    assert all(str(text) in err for text in refused.values())
    assert not (out / "same").exists()
    assert pixels(out / "other") == pixels(root / "alone" / "other")


def test_follow_ups_of_one_stem_get_two_folders(command: Command, root: Path) -> None:
    photographs, out, second = root / "photographs", root / "out", root / "second"
    second.mkdir()
    shutil.copy(photographs / "same.tif", second / "other.tif")
    followups = (photographs / "other.tif", second / "other.tif")
    command.done(*asked(root, *followups), "--out", out)
    listed = read_changes_series(out / "summary.json").followups
    assert [one.followup for one in listed] == [str(followup) for followup in followups]
    for one, alone in zip(listed, ("other", "same"), strict=True):
        assert one.folder is not None
        assert one.folder.startswith("other-")
        for name in ("changes.png", "changes-figure.png"):
            found, expected = (out / one.folder / name, root / "alone" / alone / name)
            assert found.read_bytes() == expected.read_bytes()
    done = command(*asked(root, *followups[::-1]), "--out", out)
    assert "(2 already done)" in done.out


def test_parts_are_put_together_by_the_last_one(command: Command, root: Path) -> None:
    photographs = root / "photographs"
    whole, parts = root / "whole", root / "parts"
    command.done(*asked(root, photographs), "--out", whole)
    first, last = (
        command(*asked(root, photographs), "--shard", f"{part}/2", "--out", parts, "--json")
        for part in (1, 2)
    )
    assert (first.status, last.status) == (0, 0), first.err + last.err
    assert json.loads(first.out) == {
        "out": str(parts),
        "shard": "1/2",
        "images": 1,
        "refused": 0,
    }
    assert (parts / "changes.csv").read_bytes() == (whole / "changes.csv").read_bytes()
    assert (
        json.loads(last.out)["followups"]
        == json.loads((whole / "summary.json").read_text("utf-8"))["followups"]
    )


def test_the_time_line_follows_each_change_over_the_photographs(
    command: Command, root: Path
) -> None:
    photographs, out = root / "photographs", root / "out"
    # The changes stay: two photographs show them, the one between them does not.
    shutil.copy(photographs / "other.tif", photographs / "zlast.tif")
    command.done(*asked(root, photographs), "--out", out)
    line = read_time_line(out / "series.json")
    assert line.order == "path"  # a TIFF of levels alone says no time
    assert [one.folder for one in line.followups] == ["other", "same", "zlast"]
    listed = read_changes(out / "other" / "changes.json").changes
    assert len(listed) == 16
    # Chance adds a track to 5 % of frames; the sixteen come first.
    assert len(line.tracks) <= 17
    for track in line.tracks[:16]:
        first, between, last = track.points
        assert (track.first_seen, track.last_seen, track.seen) == (0, 2, 2)
        assert (first.sighting, between.sighting, last.sighting) == ("seen", "not seen", "seen")
        assert first == last
        assert between.upper_limit_dn is not None
        assert first.amplitude_dn is not None
        assert between.amplitude_err_dn is not None
        assert between.upper_limit_dn < first.amplitude_dn / 2
        # What stands there is noise: 4.5 deviations are exceeded once in 10,000 such series.
        assert abs(between.amplitude_dn or 0.0) < 4.5 * between.amplitude_err_dn
        near = [
            change
            for change in listed
            if abs(change.reference_x_px - track.reference_x_px) < 1e-9
            and abs(change.reference_y_px - track.reference_y_px) < 1e-9
        ]
        assert [change.amplitude_dn for change in near] == [first.amplitude_dn]
    page = (out / "report.html").read_text("utf-8")
    assert 'href="other/report.html"' in page
    assert "Time line" in page


def test_follow_ups_that_state_their_time_are_in_its_order(command: Command, root: Path) -> None:
    taken = root / "taken"
    taken.mkdir()
    for name, year in (("b", 2021), ("a", 2022)):
        image = tifffile.imread(root / "photographs" / "same.tif")
        date = f"{year}:05:06 07:08:09"
        tifffile.imwrite(taken / f"{name}.tif", image, datetime=date, metadata=None)
    command.done(*asked(root, taken), "--out", root / "out")
    line = read_time_line(root / "out" / "series.json")
    assert line.order == "time"
    assert [one.folder for one in line.followups] == ["b", "a"]
    assert line.followups[0].taken == "2021:05:06 07:08:09"


def test_photographs_of_two_folders_are_paired_by_their_names(
    command: Command, root: Path, compared: list[str]
) -> None:
    photographs, before, after = root / "photographs", root / "before", root / "after"
    for folder in (before, after):
        folder.mkdir()
    for name in ("same", "other"):
        shutil.copy(photographs / "near.tif", before / f"{name}.tif")
        shutil.copy(photographs / f"{name}.tif", after / f"{name}.tif")
    shutil.copy(photographs / "near.tif", before / "alone.tif")
    shutil.copy(photographs / "same.tif", after / "late.tif")
    out = root / "out"
    words = ("changes", before, after, "--psf", root / "psf.json", "--out", out)
    done = command.done(*words)
    assert "2 follow-ups compared, 1 with changed pixels (0 already done)" in done.out
    assert "2 photographs have no partner with the same name" in done.err
    series = read_changes_series(out / "summary.json")
    assert series.reference == str(before)
    assert series.unpaired == (str(after / "late.tif"), str(before / "alone.tif"))
    assert [one.reference for one in series.followups] == [
        str(before / "other.tif"),
        str(before / "same.tif"),
    ]
    assert not (out / "series.json").exists()
    for name in ("same", "other"):
        assert pixels(out / name) == pixels(root / "alone" / name)
        document = json.loads((out / name / "changes.json").read_text("utf-8"))
        own = (root / "psf.json", before / f"{name}.tif", after / f"{name}.tif")
        assert_provenance(document, "changes", *own)
    # Another reference of one of them is another comparison, and the other one is kept.
    compared.clear()
    shutil.copy(photographs / "same.tif", before / "same.tif")
    command.done(*words)
    assert compared == ["same.tif"]


@pytest.mark.parametrize(
    ("followups", "said"),
    [
        (("photographs/same.tif",), "is a folder of references"),
        (("photographs",), "is given as both folders"),
        (("empty",), "the folder contains no image"),
        (("others",), "no photograph in"),
    ],
)
def test_folders_that_make_no_pairs_are_one_line(
    command: Command, root: Path, followups: tuple[str, ...], said: str
) -> None:
    (root / "empty").mkdir()
    (root / "others").mkdir()
    shutil.copy(root / "photographs" / "same.tif", root / "others" / "unlike.tif")
    paths = [root / name for name in followups]
    err = command.refused(1, "changes", root / "photographs", *paths, "--out", root / "out")
    assert err.count("\n") == 1
    assert said in " ".join(err.split())


def test_a_mask_of_another_size_refuses_the_photographs_of_that_size_alone(
    command: Command, root: Path
) -> None:
    photographs = root / "photographs"
    image = tifffile.imread(photographs / "same.tif")
    tifffile.imwrite(photographs / "cropped.tif", image[:-20])
    Image.fromarray(np.zeros(image.shape, np.uint8)).save(root / "mask.png")
    out = root / "out"
    command.refused(1, *asked(root, photographs), "--mask", root / "mask.png", "--out", out)
    refused = [one for one in read_changes_series(out / "summary.json").followups if one.refused]
    assert [Path(one.followup).name for one in refused] == ["cropped.tif"]
    assert "a mask has the follow-up's size" in (refused[0].refused or "")
    # An empty mask leaves nothing out.
    assert pixels(out / "same") == pixels(root / "alone" / "same")


def test_any_number_of_workers_writes_the_same_bytes(process: Command, root: Path) -> None:
    one, two = root / "1", root / "2"
    for workers, out in ((1, one), (2, two)):
        process.done(*asked(root, root / "photographs"), "--workers", workers, "--out", out)
    assert (one / "changes.csv").read_bytes() == (two / "changes.csv").read_bytes()
    first, second = (read_time_line(out / "series.json") for out in (one, two))
    assert first.tracks == second.tracks
    for name in ("same", "other"):
        assert pixels(one / name) == pixels(two / name)
        found, expected = (read_changes(out / name / "changes.json") for out in (two, one))
        assert found.model_dump(exclude={"provenance"}) == expected.model_dump(
            exclude={"provenance"}
        )


def test_follow_ups_of_letters_that_no_page_may_hold_are_compared_and_named(
    command: Command, root: Path
) -> None:
    photographs, out = root / "photographs", root / "out"
    for name, odd in (("same", "no-\udcff-utf"), ("other", "two\nlines \x1b[31m 九月")):
        (photographs / f"{name}.tif").rename(photographs / f"{odd}.tif")
    done = command.done(*asked(root, photographs), "--out", out)
    assert all(line.isprintable() for line in (done.out + done.err).splitlines())
    folders = [one.folder for one in read_changes_series(out / "summary.json").followups]
    assert all(folder is not None and folder.isprintable() for folder in folders)
    assert [one.folder for one in read_time_line(out / "series.json").followups] == folders
