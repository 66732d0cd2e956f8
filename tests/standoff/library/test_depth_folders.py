"""Depth maps beside photographs: ``evaluate`` and ``change_pairs`` with ``depth``."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from tests.standoff.conftest import Command

SHAPE = 160, 200


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """Two photographs, of one of which the depth is known."""
    rng = np.random.default_rng(3)
    for name in ("photographs", "depth"):
        (tmp_path / name).mkdir()
    for name in ("a", "b"):
        image = 800 + 150 * rng.standard_normal(SHAPE)
        tifffile.imwrite(tmp_path / "photographs" / f"{name}.tif", image.astype(np.float32))
    depth = np.full(SHAPE, 700, np.float32)
    depth[:, ::40] = 420
    tifffile.imwrite(tmp_path / "depth" / "a.tif", depth)
    return tmp_path / "photographs"


def test_a_photograph_without_depth_is_named_and_left_out(
    photographs: Path, psf_file: Path, tmp_path: Path
) -> None:
    task = standoff.EvaluationTask(
        zooms=(1.2,), crop_px=48, crops=2, contrasts_dn=(900.0,), change=standoff.Spot(sigma_px=1.5)
    )
    found = standoff.evaluate(
        "absolute-difference", photographs, psf_file, task, depth=tmp_path / "depth"
    )
    assert found.photographs.images == 1
    (refused,) = found.photographs.refused_lines
    assert "b.tif" in refused
    assert "no depth of its name" in refused
    assert found.evaluation is not None
    curve = found.evaluation.curves[0]
    assert curve.dprime_bound == [None]
    assert any("flat scenes" in note for note in found.notes)


def test_the_command_writes_pairs_with_depth(
    command: Command, photographs: Path, psf_file: Path, tmp_path: Path
) -> None:
    words = ("--psf", psf_file, "--pairs", "2", "--crop", "48", "--zooms", "1.2", "--noise", "1")
    folders = []
    for name, more in (("flat", ()), ("deep", ("--depth", tmp_path / "depth"))):
        out = tmp_path / name
        command("change-pairs", photographs / "a.tif", *words, *more, "--out", out)
        folders.append(standoff.read_change_pairs(out))
    flat, deep = ([*folder.pairs("train"), *folder.pairs("test")] for folder in folders)
    assert len(flat) == len(deep) == 4
    for one, other in zip(flat, deep, strict=True):
        assert np.array_equal(one.reference, other.reference)
        assert np.abs(one.followup - other.followup).max() > 20
    # Another folder of depths makes other pairs: the first data set is not resumed with them.
    again = command(
        *("change-pairs", photographs / "a.tif", *words, "--depth", tmp_path / "depth"),
        *("--out", tmp_path / "flat"),
    )
    assert again.status == 1
    assert "other settings" in again.err
