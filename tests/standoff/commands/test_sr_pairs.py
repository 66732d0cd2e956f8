import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from acquisition.photographs import ReadOptions, read_photograph
from analysis.sr_dataset import split_of
from tests.standoff.conftest import Command, Outcome

RNG = np.random.default_rng(12)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Six grey photographs of 100 x 130 px, four of 8 and two of 16 bits."""
    path = tmp_path / "photographs"
    path.mkdir()
    for number in range(6):
        levels = RNG.integers(0, 255 if number < 4 else 65535, (100, 130))
        pixels = levels.astype(np.uint8) if number < 4 else levels.astype(np.uint16)
        cv2.imwrite(str(path / f"{number}.png"), pixels)
    (path / "notes.txt").write_text("not an image, and not looked at")
    return path


@pytest.fixture
def psf(tmp_path: Path) -> Path:
    path = tmp_path / "psf.json"
    path.write_text(
        '{"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.8, "rho": 0.0}'
    )
    return path


def make(
    command: Command, *sources: Path, psf: Path, out: Path, more: tuple[object, ...]
) -> Outcome:
    return command(
        "sr-pairs", *sources, "--psf", psf, "--zoom", 2, "--crop", 48, "--out", out, "--json", *more
    )


def test_every_pair_of_the_manifest_is_there_and_fits(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    done = make(command, folder, psf=psf, out=out, more=("--test-fraction", 0.4))
    assert done.status == 0, done.err
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    # Crops of 48 px start at 0, 48 and 52 of 100 rows, and at 0, 48 and 82 of 130 columns.
    assert len(lines) == 6 * 9
    summary = json.loads(done.out)
    assert summary["train"] + summary["test"] == len(lines)
    for line in lines:
        high, low = (read_photograph(out / line[side]).stored for side in ("high", "low"))
        assert high.shape == (48, 48)
        assert low.shape == (24, 24)
        assert high.dtype == low.dtype
        original = read_photograph(folder / line["image"]).stored
        top, left = line["top_px"], line["left_px"]
        np.testing.assert_array_equal(high, original[top : top + 48, left : left + 48])


def test_crops_of_one_image_stay_on_one_side_of_the_split(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    make(command, folder, psf=psf, out=out, more=("--test-fraction", 0.5))
    splits: dict[str, set[str]] = {}
    for text in (out / "manifest.jsonl").read_text().splitlines():
        line = json.loads(text)
        splits.setdefault(line["image"], set()).add(line["split"])
    assert all(len(names) == 1 for names in splits.values())


def test_an_interrupted_run_goes_on_and_ends_as_if_it_had_not_been(
    command: Command, folder: Path, psf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    make(command, folder, psf=psf, out=whole, more=())
    calls: list[Path] = []

    def read_three(path: Path, options: ReadOptions) -> object:
        calls.append(path)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return read_photograph(path, options)

    with monkeypatch.context() as patch:
        patch.setattr("standoff.library.sr_pairs.read_photograph", read_three)
        assert make(command, folder, psf=psf, out=broken, more=()).status == 130
    # A power cut besides, which took the end of one commit.
    [records] = (broken / "shards").glob("*.records")
    records.write_bytes(records.read_bytes()[:-10])
    resumed = make(command, folder, psf=psf, out=broken, more=())
    assert json.loads(resumed.out)["images_found_done"] == 1
    files, again = (
        sorted(p.relative_to(out) for p in out.rglob("*") if p.is_file() and p.suffix != ".records")
        for out in (whole, broken)
    )
    assert files == again
    for file in files:
        if file.name != "dataset.json":  # its provenance names the time
            assert (whole / file).read_bytes() == (broken / file).read_bytes()


def test_float_pairs_are_tiffs_in_the_input_s_levels(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    make(command, folder / "0.png", psf=psf, out=out, more=("--float", "--test-fraction", 0))
    low = tifffile.imread(sorted((out / "train" / "low").iterdir())[0])
    assert low.dtype == np.float32
    assert np.any(low != np.rint(low))


def test_other_settings_are_refused(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    make(command, folder, psf=psf, out=out, more=())
    done = make(command, folder, psf=psf, out=out, more=("--seed", 5))
    assert done.status == 1
    assert "other settings" in done.err


def test_images_too_small_and_folders_without_images_are_named(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((20, 30), np.uint8))
    for source, name in ((small, "small.png"), (out.parent / "none.png", "none.png")):
        done = make(command, source, psf=psf, out=out, more=())
        assert done.status == 1
        assert name in done.err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "contains no image" in make(command, empty, psf=psf, out=out, more=()).err
    assert make(command, folder, psf=psf, out=out, more=("--test-fraction", 2)).status == 2


def test_the_split_of_an_image_depends_on_nothing_but_it_and_the_seed() -> None:
    digests = [f"{number:064x}" for number in range(4000)]
    is_test = [split_of(digest, 3, 0.25) == "test" for digest in digests]
    assert np.mean(is_test) == pytest.approx(0.25, abs=0.03)  # 4000 draws: 0.7 %, four of those


def test_a_bad_photograph_is_named_and_keeps_no_other_from_its_pairs(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    (folder / "0broken.png").write_bytes(b"no picture")
    done = make(command, folder, psf=psf, out=out, more=())
    assert done.status == 1
    assert "0broken.png" in done.err
    assert "1 of 7 images gave no pairs" in done.err
    assert len((out / "manifest.jsonl").read_text().splitlines()) == 6 * 9
    (folder / "0broken.png").unlink()
    assert json.loads(make(command, folder, psf=psf, out=out, more=()).out)["refused"] == []


def test_settings_that_gave_no_pair_may_be_replaced(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    assert make(command, folder, psf=psf, out=out, more=("--crop", 500)).status == 1
    assert make(command, folder, psf=psf, out=out, more=()).status == 0


def test_a_file_that_is_missing_is_made_again(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pairs"
    make(command, folder, psf=psf, out=out, more=())
    manifest = (out / "manifest.jsonl").read_text()
    victim = out / json.loads(manifest.splitlines()[3])["low"]
    before = victim.read_bytes()
    victim.unlink()
    done = make(command, folder, psf=psf, out=out, more=())
    assert json.loads(done.out)["images_found_done"] == 5
    assert victim.read_bytes() == before
    assert sorted((out / "manifest.jsonl").read_text().splitlines()) == sorted(
        manifest.splitlines()
    )


def test_colours_keep_their_order_and_people_read_a_line(
    command: Command, psf: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(8)
    pixels = rng.integers(0, 255, (96, 96, 3)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "colour.png"), pixels[:, :, ::-1])  # OpenCV writes blue first
    out = tmp_path / "pairs"
    words = ("sr-pairs", tmp_path / "colour.png", "--psf", psf, "--zoom", 2, "--crop", 48)
    done = command.done(*words, "--out", out, "--test-fraction", 0)
    assert done.out == (
        f"{out}: 4 pairs for training, 0 for testing, from 1 images (0 already done)\n"
    )
    first = next(path for path in sorted((out / "train" / "high").iterdir()))
    np.testing.assert_array_equal(read_photograph(first).stored, pixels[:48, :48])


def test_a_file_in_the_way_of_the_pairs_is_named(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    (tmp_path / "pairs").write_text("in the way")
    done = make(command, folder, psf=psf, out=tmp_path / "pairs", more=())
    assert done.status == 1
    assert f"{tmp_path / 'pairs'}" in done.err
    assert done.err.count("\n") == 1


def test_the_field_of_a_psf_file_serves_whole_frames_and_threads_change_nothing(
    command: Command, folder: Path, psf: Path, tmp_path: Path
) -> None:
    document = json.loads(psf.read_text())
    document["field"] = {
        "width_px": 130,
        "height_px": 100,
        "coefficients_px2": [[0.5, 0, 0, 1, 0, 1], [0, 0, 0, 0, 0, 0], [0.5, 0, 0, 1, 0, 1]],
    }
    with_field = tmp_path / "field.json"
    with_field.write_text(json.dumps(document))
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), RNG.integers(0, 255, (90, 130)).astype(np.uint8))

    def lows(source: Path, name: str, psf: Path, *more: object) -> tuple[list[bytes], str]:
        out = tmp_path / name
        done = make(command, source, psf=psf, out=out, more=("--test-fraction", 0, *more))
        assert done.status == 0, done.err
        return [path.read_bytes() for path in sorted((out / "train" / "low").iterdir())], done.err

    frame, _ = lows(folder / "0.png", "frame", with_field)
    same, notes = lows(folder / "0.png", "same", with_field, "--threads", 2)
    plain, _ = lows(folder / "0.png", "plain", psf)
    assert frame == same
    assert "one PSF" not in notes
    assert all(own != one for own, one in zip(frame, plain, strict=True))
    about = json.loads((tmp_path / "frame" / "dataset.json").read_text())
    assert about["psf_field"]["size"] == [130, 100]
    of_other, notes = lows(other, "other", with_field)
    assert "frames of 130 x 100 px; one PSF is used" in notes
    assert of_other == lows(other, "other_plain", psf)[0]
