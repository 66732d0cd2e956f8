import json
import os
import shutil
import tarfile
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import webdataset
from numpy.typing import NDArray

from acquisition.photographs import ReadOptions, read_photograph
from analysis.errors import SrDatasetError, SweepError
from analysis.sr_dataset import SrDatasetSettings, SrDatasetSummary, write_sr_dataset
from analysis.sweep import SweepOptions
from simulation import GaussianPsf
from standoff.library import Call
from standoff.library.sr_pairs import pair_photograph

leaves_files_open = pytest.mark.filterwarnings(
    # The library webdataset leaves a tar file open that it has read to the end.
    "ignore:unclosed file:ResourceWarning",
    "ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning",
)

CROP_PX = 24
SETTINGS = {
    "zoom": 2.0,
    "model": "matched",
    "psf": GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8),
    "crop_px": CROP_PX,
    "stride_px": CROP_PX,
    "test_fraction": 0.3,
    "seed": 0,
    "is_float": False,
    "reading": {"encoding": "auto", "page": None, "is_mean": False},
}
READ = partial(pair_photograph, ReadOptions())


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """150 grey photographs of 30 x 40 px, four pairs each: batches of two on average."""
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(4)
    for number in range(150):
        pixels = rng.integers(0, 255, (30, 40)).astype(np.uint8)
        cv2.imwrite(str(folder / f"scene.{number:03d}.png"), pixels)
    return folder


def write(
    out: Path,
    photographs: Path,
    options: SweepOptions | None = None,
    call: Call | None = None,
    **more: object,
) -> SrDatasetSummary:
    settings = SrDatasetSettings(**{**SETTINGS, **more})  # type: ignore[arg-type]
    images = sorted(photographs.iterdir())
    return write_sr_dataset(call or Call("training_pairs"), out, images, settings, READ, options)


def files_of(out: Path) -> dict[str, bytes]:
    """Every file that readers need, but for dataset.json, which names the time."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and path.name != "dataset.json" and path.parent.name != "shards"
    }


def manifest_of(out: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]


@pytest.mark.slow
def test_every_pair_is_listed_once_in_the_order_of_the_images(
    photographs: Path, tmp_path: Path
) -> None:
    done = write(tmp_path, photographs)
    lines = manifest_of(tmp_path)
    assert len(lines) == done.train + done.test == 150 * 4
    assert [line["image"] for line in lines[::4]] == sorted(p.name for p in photographs.iterdir())
    places = [(line["top_px"], line["left_px"]) for line in lines[:4]]
    assert places == [(0, 0), (0, 16), (6, 0), (6, 16)]


@pytest.mark.slow
@leaves_files_open
def test_the_library_webdataset_reads_the_pairs_of_the_folders(
    photographs: Path, tmp_path: Path
) -> None:
    folders, tars = tmp_path / "folders", tmp_path / "tars"
    write(folders, photographs)
    write(tars, photographs, format="webdataset")
    by_place = {(p["image"], p["top_px"], p["left_px"]): p for p in manifest_of(folders)}
    names = sorted(path.name for path in tars.glob("*.tar"))
    for split in ("train", "test"):
        own = [name for name in names if name.startswith(split)]
        assert own == [f"{split}-{number:06d}.tar" for number in range(len(own))]
        urls = str(tars / f"{split}-{{000000..{len(own) - 1:06d}}}.tar")
        for sample in webdataset.WebDataset(urls, shardshuffle=False):
            facts = json.loads(sample["json"])
            pair = by_place.pop((facts["image"], facts["top_px"], facts["left_px"]))
            assert pair["split"] == facts["split"] == split
            for side in ("high", "low"):
                assert sample[f"{side}.png"] == (folders / str(pair[side])).read_bytes()
    assert by_place == {}
    for line in manifest_of(tars):
        with tarfile.open(tars / str(line["tar"])) as tar:
            assert {line["high"], line["low"]} <= set(tar.getnames())


@leaves_files_open
def test_webdataset_decodes_colours_and_floats(tmp_path: Path) -> None:
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    pixels = np.random.default_rng(2).integers(0, 255, (CROP_PX, CROP_PX, 3)).astype(np.uint8)
    cv2.imwrite(str(photographs / "a.png"), pixels[:, :, ::-1])  # OpenCV writes blue first
    shared: dict[str, Any] = {"format": "webdataset", "test_fraction": 0}
    write(tmp_path / "png", photographs, **shared)
    write(tmp_path / "tif", photographs, is_float=True, **shared)
    url = str(tmp_path / "png" / "train-000000.tar")
    (sample,) = webdataset.WebDataset(url, shardshuffle=False).decode("rgb8")
    np.testing.assert_array_equal(sample["high.png"], pixels)
    assert sample["low.png"].shape == (CROP_PX // 2, CROP_PX // 2, 3)
    with tarfile.open(tmp_path / "tif" / "train-000000.tar") as tar:
        assert [name.split(".", 1)[1] for name in tar.getnames()] == ["high.tif", "json", "low.tif"]
        tar.extractall(tmp_path, filter="data")
    (low,) = tmp_path.glob("*.low.tif")
    assert read_photograph(low).stored.dtype == np.float32


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_a_batch_waits_for_the_disk_once(
    photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str
) -> None:
    calls: list[int] = []
    monkeypatch.setattr(os, "fsync", calls.append)
    write(tmp_path, photographs, format=layout)
    # Seven bits of the SHA-256 of their paths put them into batches of two on average.
    paths = (os.fsencode(path) for path in photographs.iterdir())
    batches = {sha256(path).digest()[0] >> 1 for path in paths}
    assert len(calls) == len(batches) + 1  # and the folder of the records


@pytest.mark.slow  # starts worker processes
def test_two_workers_write_the_same_bytes(photographs: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    alone = write(one, photographs, format="webdataset")
    shared = write(two, photographs, SweepOptions(workers=2), format="webdataset")
    assert shared == alone
    assert files_of(two) == files_of(one)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_parts_in_any_order_and_a_last_run_end_as_one_run(
    photographs: Path, tmp_path: Path, layout: str
) -> None:
    one, parts = tmp_path / "one", tmp_path / "parts"
    write(one, photographs, format=layout)
    pairs = 0
    for part in (3, 1, 2):
        done = write(parts, photographs, SweepOptions(part=(part, 3)), format=layout)
        pairs += done.train + done.test
        assert not (parts / "manifest.jsonl").exists()
    assert pairs == 150 * 4
    assert write(parts, photographs, format=layout).images_found_done == 150
    assert files_of(parts) == files_of(one)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["folder", "webdataset"])
@pytest.mark.parametrize("damage", ["missing", "empty", "short"])
def test_what_a_power_cut_took_is_made_again(
    photographs: Path, tmp_path: Path, layout: str, damage: str
) -> None:
    write(tmp_path, photographs, format=layout)
    before = files_of(tmp_path)
    pattern = "shards/*.tar" if layout == "webdataset" else "train/low/*.png"
    victim = sorted(tmp_path.glob(pattern))[5]
    whole = victim.read_bytes()
    victim.unlink()
    if damage != "missing":
        victim.write_bytes(b"" if damage == "empty" else whole[:-1])
    again = write(tmp_path, photographs, format=layout)
    assert 140 <= again.images_found_done < 150  # all but those of one batch
    assert files_of(tmp_path) == before


@pytest.mark.slow
def test_a_further_photograph_leaves_the_pairs_of_others_as_they_are(
    photographs: Path, tmp_path: Path
) -> None:
    own, out = tmp_path / "photographs", tmp_path / "pairs"
    shutil.copytree(photographs, own)
    write(out, own)
    for path in out.glob("t*/*/*.png"):
        os.utime(path, ns=(0, 0))
    pixels = np.random.default_rng(9).integers(0, 255, (30, 40)).astype(np.uint8)
    cv2.imwrite(str(own / "new.png"), pixels)
    write(out, own)
    written = {path.name for path in out.glob("t*/*/*.png") if path.stat().st_mtime_ns}
    assert {name.split("_")[0] for name in written} == {"new"}
    assert len(manifest_of(out)) == 151 * 4


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["folder", "webdataset"])
@pytest.mark.parametrize("before", [127, 140])
def test_photographs_that_came_later_end_as_one_run_and_only_they_are_read(
    photographs: Path,
    tmp_path: Path,
    layout: str,
    before: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own, grown, whole = (tmp_path / name for name in ("photographs", "grown", "whole"))
    own.mkdir()
    named = sorted(photographs.iterdir())
    for path in named[:before]:
        shutil.copy2(path, own)
    write(grown, own, format=layout)
    for path in named[before:]:
        shutil.copy2(path, own)
    opened: list[str] = []

    def noted(path: Path, options: ReadOptions) -> object:
        opened.append(path.name)
        return read_photograph(path, options)

    with monkeypatch.context() as patch:
        patch.setattr("standoff.library.sr_pairs.read_photograph", noted)
        done = write(grown, own, format=layout)
    assert sorted(opened) == [path.name for path in named[before:]]
    assert done.images_found_done == before
    write(whole, own, format=layout)
    assert files_of(grown) == files_of(whole)


@pytest.mark.slow
def test_of_photographs_with_the_same_content_one_is_cut(photographs: Path, tmp_path: Path) -> None:
    own, out = tmp_path / "photographs", tmp_path / "pairs"
    call = Call("training_pairs")
    shutil.copytree(photographs, own)
    shutil.copy(own / "scene.007.png", own / "a copy.png")
    shutil.copy(own / "scene.007.png", own / "z copy.png")
    done = write(out, own, call=call)
    assert (done.images, done.copies, done.train + done.test) == (152, 2, 150 * 4)
    [note] = [one for one in call.notes if "content" in one]
    assert note.startswith("2 images have the same content as another")
    kept, other = str(own / "a copy.png"), str(own / "scene.007.png")
    listed = (out / "shards" / "copies.txt").read_text()
    assert listed == f"{other} = {kept}\n{own / 'z copy.png'} = {kept}\n"


def with_bad_ones(photographs: Path, folder: Path) -> Path:
    shutil.copytree(photographs, folder)
    for number in range(12):
        (folder / f"broken.{number:02d}.png").write_bytes(b"no picture %d" % number)
    cv2.imwrite(str(folder / "small.png"), np.zeros((9, 9), np.uint8))
    (folder / "gone.png").symlink_to(folder / "nothing.png")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_what_gives_no_pairs_is_listed_and_the_rest_done(
    photographs: Path, tmp_path: Path, layout: str
) -> None:
    own = with_bad_ones(photographs, tmp_path / "photographs")
    done = write(tmp_path / "pairs", own, format=layout)
    assert (done.refused_images, done.train + done.test) == (14, 150 * 4)
    assert len(done.refused) == 10
    assert done.refused_list is not None
    listed = Path(done.refused_list).read_text().splitlines()
    assert len(listed) == 14
    for name in ("broken.00.png", "broken.11.png", "small.png", "gone.png"):
        assert sum(name in line for line in listed) == 1
    again = write(tmp_path / "pairs", own, format=layout)
    assert again.refused_images == 14
    assert again.images_found_done == 164


def test_a_strict_run_stops_at_the_first_that_gives_no_pairs(
    photographs: Path, tmp_path: Path
) -> None:
    own = with_bad_ones(photographs, tmp_path / "photographs")
    with pytest.raises(SweepError, match=r"broken|small|gone"):
        write(tmp_path / "pairs", own, SweepOptions(strict=True))


@pytest.mark.slow
def test_what_a_kill_left_is_cleared_away(photographs: Path, tmp_path: Path) -> None:
    write(tmp_path, photographs)
    before = files_of(tmp_path)
    left = tmp_path / "shards" / "0000000000000000-train.tar.0a1b.part"
    left.write_bytes(b"half a")
    write(tmp_path, photographs)
    assert files_of(tmp_path) == before
    assert not left.exists()


@pytest.mark.slow
def test_other_layouts_in_the_same_folder_are_refused(photographs: Path, tmp_path: Path) -> None:
    write(tmp_path, photographs)
    with pytest.raises(SrDatasetError, match="other settings"):
        write(tmp_path, photographs, format="webdataset")


@pytest.mark.slow
def test_a_dataset_of_before_there_was_another_layout_goes_on(
    photographs: Path, tmp_path: Path
) -> None:
    write(tmp_path, photographs)
    about = tmp_path / "dataset.json"
    document = json.loads(about.read_text())
    assert document.pop("format") == "folder"
    about.write_text(json.dumps(document))
    assert write(tmp_path, photographs).images_found_done == 150


@pytest.mark.slow  # two thousand photographs
def test_two_thousand_photographs_with_bad_ones_and_copies(tmp_path: Path) -> None:
    own, out = tmp_path / "photographs", tmp_path / "pairs"
    own.mkdir()
    rng = np.random.default_rng(11)
    for number in range(2000):
        path = own / f"{number:05d}.png"
        if number % 100 == 50:
            path.write_bytes(b"no picture %d" % number)
        elif number % 100 == 51:
            path.symlink_to(own / "nothing.png")
        elif number % 100 == 52:
            shutil.copy(own / f"{number - 3:05d}.png", path)
        else:
            cv2.imwrite(str(path), rng.integers(0, 255, (12, 12)).astype(np.uint8))
    done = write(out, own, crop_px=12, stride_px=12, model="bicubic")
    assert (done.images, done.copies, done.refused_images) == (2000, 20, 40)
    assert done.train + done.test == len(manifest_of(out)) == 1940
    assert done.test == pytest.approx(0.3 * 1940, abs=81)  # four of its deviations


def test_pairs_that_make_no_batch_are_counted(tmp_path: Path) -> None:
    """A grey picture among colours stops a training: "expected 3 channels, but got 1"."""
    rng = np.random.default_rng(1)
    folder = tmp_path / "mixed"
    folder.mkdir()
    pictures: dict[str, NDArray[Any]] = {
        "grey": rng.integers(0, 255, (30, 40)).astype(np.uint8),
        "colour": rng.integers(0, 255, (30, 40, 3)).astype(np.uint8),
        "wide": rng.integers(0, 65535, (30, 40)).astype(np.uint16),
    }
    for name, pixels in pictures.items():
        cv2.imwrite(str(folder / f"{name}.png"), pixels)
    call = Call("training_pairs")
    write(tmp_path / "out", folder, call=call)
    (note,) = [each for each in call.notes if "kinds" in each]
    assert "4 grey uint8" in note
    assert "4 RGB uint8" in note
    assert "4 grey uint16" in note
    one = Call("training_pairs")
    (folder / "grey.png").unlink()
    (folder / "wide.png").unlink()
    write(tmp_path / "one", folder, call=one)
    assert not [each for each in one.notes if "kinds" in each]
