"""A data set of change pairs: whole or resumed it is the same bits, split by photograph."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import standoff
from analysis.errors import ResultsFileError
from analysis.evaluation.change_pairs import _dataset as dataset, labelled_pairs, read_dataset
from analysis.evaluation.change_pairs._pairs import read_pairs
from standoff.errors import ApplicationError

TASK = standoff.ChangePairsTask(pairs=2, crop_px=48, zooms=(1.0, 1.5), model="matched", seed=3)
PSF = standoff.GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.7, rho=0.1)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(5)
    for number in range(6):
        levels = 100 + 20 * rng.standard_normal((150, 160 + number))
        tifffile.imwrite(folder / f"{number}.tif", levels.astype(np.float32))
    (folder / "copy-of-0.tif").write_bytes((folder / "0.tif").read_bytes())
    tifffile.imwrite(folder / "small.tif", np.full((40, 40), 100, np.float32))
    (folder / "damaged.tif").write_bytes(b"II*\0no image")
    return folder


def contents(out: Path) -> dict[str, bytes]:
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*.npz")}


@pytest.mark.slow
def test_interrupted_and_resumed_it_is_the_same_bits_as_in_one_go(
    photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = standoff.change_pairs(photographs, tmp_path / "whole", PSF, TASK)
    real, calls = labelled_pairs, iter(range(100))

    def interrupted(*given: Any) -> Any:
        if next(calls) == 3:
            raise KeyboardInterrupt
        return real(*given)

    monkeypatch.setattr(dataset, "labelled_pairs", interrupted)
    with pytest.raises(KeyboardInterrupt):
        standoff.change_pairs(photographs, tmp_path / "resumed", PSF, TASK)
    monkeypatch.setattr(dataset, "labelled_pairs", real)
    assert not read_dataset(tmp_path / "resumed").is_complete
    resumed = standoff.change_pairs(photographs, tmp_path / "resumed", PSF, TASK)
    assert 3 <= resumed.photographs.found_done <= 5  # with those that are refused
    assert contents(tmp_path / "resumed") == contents(tmp_path / "whole")
    assert resumed.dataset.files == whole.dataset.files
    again = standoff.change_pairs(photographs, tmp_path / "resumed", PSF, TASK)
    assert again.photographs.found_done == 9


@pytest.mark.slow
def test_only_new_photographs_are_cut(
    photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, cut = labelled_pairs, []

    def noted(*given: Any) -> Any:
        cut.append(given[1])
        return real(*given)

    monkeypatch.setattr(dataset, "labelled_pairs", noted)
    files = [photographs / f"{number}.tif" for number in range(6)]
    standoff.change_pairs(files[:4], tmp_path / "grown", PSF, TASK)
    grown = standoff.change_pairs(files, tmp_path / "grown", PSF, TASK)
    assert grown.photographs.found_done == 4
    assert len(cut) == len(set(cut)) == 6
    whole = standoff.change_pairs(files, tmp_path / "whole", PSF, TASK)
    assert contents(tmp_path / "grown") == contents(tmp_path / "whole")
    assert grown.dataset.files == whole.dataset.files


def test_pairs_of_a_photograph_in_colour_are_in_colour(tmp_path: Path) -> None:
    folder = tmp_path / "photographs"
    folder.mkdir()
    rng = np.random.default_rng(8)
    means = np.array([100.0, 60.0, 30.0])
    levels = (means + 2 * rng.standard_normal((150, 160, 3))).astype(np.float32)
    tifffile.imwrite(folder / "colour.tif", levels, photometric="rgb")
    tifffile.imwrite(folder / "grey.tif", levels[:, :, 0])
    made = standoff.change_pairs(folder, tmp_path / "out", PSF, TASK)
    pairs = {one.photograph: read_pairs(tmp_path / "out" / one.file) for one in made.dataset.files}
    for pair in pairs["grey.tif"]:
        assert (pair.reference.ndim, pair.followup.ndim) == (2, 2)
    for pair in pairs["colour.tif"]:
        assert pair.reference.shape == (48, 48, 3)
        assert pair.followup.shape == (*pair.mask.shape, 3)
        # Hues are the photograph's: red, green and blue are those of the file.
        np.testing.assert_allclose(pair.reference.mean((0, 1)), means, atol=1.0)
        if pair.is_changed:  # a spot adds the same to all channels, where the mask says
            added = pair.followup[pair.mask].mean(0) - means
            assert np.ptp(added) < 0.3 * np.abs(added).max()


@pytest.mark.slow(minutes=0.3)
def test_two_workers_write_the_same_bits(photographs: Path, tmp_path: Path) -> None:
    standoff.change_pairs(photographs, tmp_path / "one", PSF, TASK)
    two = standoff.SweepOptions(workers=2)
    standoff.change_pairs(photographs, tmp_path / "two", PSF, TASK, sweep=two)
    assert contents(tmp_path / "two") == contents(tmp_path / "one")


@pytest.mark.slow
def test_the_document_says_what_is_there_and_what_could_not_be_used(
    photographs: Path, tmp_path: Path
) -> None:
    made = standoff.change_pairs(photographs, tmp_path, PSF, TASK)
    found = read_dataset(tmp_path)
    assert found == made.dataset
    stored = json.loads((tmp_path / "dataset.json").read_bytes())
    assert stored["schema"] == "standoff.change-pairs/1"
    assert stored["psf"] == {"sigma_x_px": 0.8, "sigma_y_px": 0.7, "rho": 0.1}
    assert found.task == TASK
    assert found.is_complete
    assert (found.refused_photographs, len(found.files)) == (2, 6)  # a copy has no file of its own
    assert {"small.tif", "damaged.tif"} == {
        name for name in ("small.tif", "damaged.tif") if any(name in one for one in found.refused)
    }
    assert found.provenance is not None
    assert {one.sha256 for one in found.provenance.inputs} == {one.sha256 for one in found.files}
    for split in ("train", "test"):
        pairs = list(found.pairs(split))
        assert len(pairs) == getattr(found, split)
        assert all(one.mask.shape == one.followup.shape for one in pairs)
        assert [one.is_changed for one in pairs] == [False, True] * (len(pairs) // 2)


@pytest.mark.slow
def test_a_photograph_is_in_one_split_whatever_else_there_is(
    photographs: Path, tmp_path: Path
) -> None:
    task = TASK.model_copy(update={"test_fraction": 0.5})
    all_of_them = standoff.change_pairs(photographs, tmp_path / "all", PSF, task).dataset
    one = standoff.change_pairs(photographs / "2.tif", tmp_path / "one", PSF, task).dataset
    assert {file.split for file in all_of_them.files} == {"train", "test"}
    assert one.files[0] in all_of_them.files
    assert all(file.file.startswith(f"{file.split}/") for file in all_of_them.files)


@contextmanager
def refused(text: str, kind: type[Exception] = ApplicationError) -> Iterator[None]:
    with pytest.raises(kind) as caught:
        yield
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_other_settings_want_another_folder_and_a_damaged_file_is_named(
    photographs: Path, tmp_path: Path
) -> None:
    one = photographs / "1.tif"
    made = standoff.change_pairs(one, tmp_path, PSF, TASK)
    other = TASK.model_copy(update={"seed": 4})
    with refused("other settings"):
        standoff.change_pairs(one, tmp_path, PSF, other)
    with refused("other settings"):
        standoff.change_pairs(one, tmp_path, standoff.GaussianPsf(1.0, 1.0, 0.0), TASK)
    (file,) = made.dataset.files
    whole = (tmp_path / file.file).read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"PK\x03\x04"):
        (tmp_path / file.file).write_bytes(content)
        with refused("is damaged", ResultsFileError):
            list(made.dataset.pairs(file.split))
    standoff.change_pairs(one, tmp_path, PSF, TASK)  # makes it again
    assert (tmp_path / file.file).read_bytes() == whole


def test_a_folder_in_which_nothing_can_be_used_is_an_error(
    photographs: Path, tmp_path: Path
) -> None:
    with refused("no photograph could be used"):
        standoff.change_pairs(photographs / "small.tif", tmp_path, PSF, TASK)
