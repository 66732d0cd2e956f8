"""`standoff pose` with a folder of follow-ups."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tifffile

from acquisition.photographs._reader import read_photograph
from analysis.detectability._curves import DetectabilityCurves
from analysis.pose._quality import read_pose_series
from analysis.results_file import write_results
from standoff.library.series import _pose_work as pose_work, _references as references
from tests.analysis.detectability.test_curves import curve
from tests.calibration.registration.test_tracking import pose, scene, seen_from
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

ZOOMS = (1.05, 1.1, 1.2)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reference, and follow-ups in the same folder."""
    folder = tmp_path_factory.mktemp("photographs")
    tifffile.imwrite(folder / "reference.tif", scene().astype("float32"))
    for number, zoom in enumerate(ZOOMS):
        image = seen_from(scene(), pose(zoom)).astype("float32")
        tifffile.imwrite(folder / f"frame-{number}.tif", image)
    return folder


@pytest.fixture
def folder(photographs: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(photographs, tmp_path / "photographs"))


Asked = Callable[..., tuple[object, ...]]


@pytest.fixture
def asked(folder: Path, tmp_path: Path) -> Asked:
    curves = tmp_path / "curves.json"
    write_results(curves, DetectabilityCurves(curves=[curve()]))

    def arguments(*followups: Path) -> tuple[object, ...]:
        own = ("--curves", curves, "--min-dprime", 3.2)
        return ("pose", folder / "reference.tif", *followups, *own)

    return arguments


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the follow-ups that are judged, as they are."""
    names: list[str] = []
    judge = pose_work.judged_pose

    def listing(near: Any, far: Any, demand: Any) -> Any:
        names.append(far.path.name)
        return judge(near, far, demand)

    monkeypatch.setattr(pose_work, "judged_pose", listing)
    return names


@pytest.mark.slow
def test_each_of_a_folder_is_judged_as_it_is_alone(
    command: Command, asked: Asked, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = command.done(*asked(folder), "--out", out)
    assert "2 of 3 poses accepted: min d' of at least 3.2 (0 already done)" in done.out
    series = read_pose_series(out / "summary.json")
    assert (series.accepted, series.rejected, series.refused) == (2, 1, 0)
    own = {"followup", "sha256", "refused"}
    for number, listed in enumerate(series.followups):
        followup = folder / f"frame-{number}.tif"
        alone = json.loads(command(*asked(followup), "--json").out)
        assert listed.followup == str(followup)
        own_files = (tmp_path / "curves.json", folder / "reference.tif", followup)
        assert_provenance(alone, "pose", *own_files)
        for key, value in listed.model_dump(mode="json", exclude=own).items():
            assert value == alone[key]
        assert series.curve.model_dump() == alone["curve"]
    document = json.loads((out / "summary.json").read_text("utf-8"))
    assert_provenance(document, "pose", tmp_path / "curves.json", folder / "reference.tif")
    with (out / "poses.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["followup"] for line in lines] == [one.followup for one in series.followups]
    assert [float(line["dprime_decisive"]) for line in lines] == [
        one.dprime_decisive for one in series.followups
    ]


@pytest.mark.slow
def test_nothing_is_judged_twice_until_something_changes(
    command: Command, asked: Asked, folder: Path, tmp_path: Path, judged: list[str]
) -> None:
    out = tmp_path / "out"
    first = command(*asked(folder), "--out", out, "--json")
    assert len(judged) == 3
    judged.clear()
    again = command(*asked(folder), "--out", out, "--json")
    assert judged == []
    without = [json.loads(one.out) for one in (first, again)]
    for document in without:
        del document["provenance"]
    assert without[0] == without[1]
    shutil.copy(folder / "frame-1.tif", folder / "frame-7.tif")
    command.done(*asked(folder), "--out", out)
    assert judged == ["frame-7.tif"]
    judged.clear()
    command.done(*asked(folder), "--criterion", "quantile", "--out", out)
    assert len(judged) == 4


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_was(
    command: Command,
    asked: Asked,
    folder: Path,
    tmp_path: Path,
    judged: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judge = pose_work.judged_pose

    def interrupted(near: Any, far: Any, demand: Any) -> Any:
        if len(judged) == 2:
            raise KeyboardInterrupt
        return judge(near, far, demand)

    with monkeypatch.context() as patched:
        patched.setattr(pose_work, "judged_pose", interrupted)
        assert command(*asked(folder), "--out", tmp_path / "out").status == 130
    command.done(*asked(folder), "--out", tmp_path / "out")
    assert sorted(judged) == ["frame-0.tif", "frame-1.tif", "frame-2.tif"]


@pytest.mark.slow
def test_what_cannot_be_judged_is_listed_and_counted(
    command: Command, asked: Asked, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    (folder / "cut.tif").write_bytes((folder / "frame-0.tif").read_bytes()[:5000])
    missing = folder / "missing.tif"
    err = command.refused(1, *asked(folder, missing), "--out", out)
    assert err.splitlines()[-1] == (
        "standoff: 2 of 5 follow-ups gave nothing; the verdicts on the others are complete"
    )
    series = read_pose_series(out / "summary.json")
    refused = {Path(one.followup).name: one.refused for one in series.followups if one.refused}
    assert set(refused) == {"cut.tif", "missing.tif"}
    assert all(str(text) in err for text in refused.values())
    assert series.accepted + series.rejected == 3
    # Mended, and left away.
    shutil.copy(folder / "frame-0.tif", folder / "cut.tif")
    command.done(*asked(folder), "--out", out)
    err = command.refused(1, *asked(folder, missing), "--strict", "--out", out)
    assert err.startswith(f"standoff: cannot read {missing}")
    assert err.count("\n") == 1


@pytest.mark.slow
def test_of_many_the_first_and_the_worst_few_are_shown(
    command: Command, asked: Asked, folder: Path, tmp_path: Path
) -> None:
    for number in range(10, 31):
        shutil.copy(folder / "frame-0.tif", folder / f"frame-{number}.tif")
    done = command.done(*asked(folder), "--out", tmp_path / "out")
    first, worst = done.out.split("Follow-ups with the lowest d'")
    assert first.count("frame-") == 5
    assert worst.count("frame-") == 5
    assert worst.index("frame-2.tif") < worst.index("frame-1.tif") < worst.index("frame-10.tif")


@pytest.mark.slow
def test_the_reference_is_read_once_by_whoever_works(
    command: Command,
    asked: Asked,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read: list[str] = []

    def listing(path: Path, *options: Any) -> Any:
        read.append(path.name)
        return read_photograph(path, *options)

    monkeypatch.setattr(f"{references.__name__}.read_photograph", listing)
    references._same_photograph.cache_clear()
    command.done(*asked(folder), "--out", tmp_path / "out")
    assert sorted(read) == ["frame-0.tif", "frame-1.tif", "frame-2.tif", "reference.tif"]


@pytest.mark.slow
def test_any_number_of_workers_writes_the_same_bytes(
    command: Command, process: Command, asked: Asked, folder: Path, tmp_path: Path
) -> None:
    (folder / "frame-2.tif").unlink()
    command.done(*asked(folder), "--out", tmp_path / "one", "--workers", 1)
    process.done(*asked(folder), "--out", tmp_path / "two", "--workers", 2)
    for name in ("poses.csv", "followups.sweep"):
        one, two = (_content(tmp_path / out / name) for out in ("one", "two"))
        assert one == two
        assert one


def _content(path: Path) -> dict[str, bytes]:
    if path.is_file():
        return {path.name: path.read_bytes()}
    # Each worker has a segment of its own, and what it did in it.
    lines = [line for file in path.glob("*.records") for line in file.read_bytes().splitlines()]
    return {"records": b"\n".join(sorted(lines))}
