"""Designs on disk: the same to the bit, within their limit, and never a reason to fail."""

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from analysis import design_cache
from analysis.design_cache import FOLDER_VARIABLE, LIMIT_VARIABLE, DesignCache
from simulation import (
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    Model,
    Psf,
    SamplingGrid,
    zoom,
    zoom_kernels,
)
from simulation.arrays import FloatArray
from simulation.kept_kernels import Arrays, keep_kernels, kept
from simulation.psf import CORRECTION_SPLINES, OtfCorrection

SHAPE = (90, 110)
SOFT = GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.6)
LENS = MeasuredPsf(lens=LensOtf(cut_off_period_px=(0.3, -0.1, 0.4)), gaussian=SOFT)
PLENTY = 1e9


def _never() -> Arrays:
    raise AssertionError("designed again")


def _silent(text: str) -> None:
    raise AssertionError(f"remarked: {text}")


def _design(value: float, size: int = 3) -> Callable[[], Arrays]:
    return lambda: (np.full(size, value), np.full((2, size), -value))


@pytest.fixture
def cache(tmp_path: Path) -> DesignCache:
    return DesignCache(tmp_path / "new" / "folder", PLENTY, _silent)


@pytest.fixture
def forgotten() -> Iterator[Callable[[], None]]:
    """Return what makes this process forget its operators, as a new one has none."""

    def forget() -> None:
        for remembered in (
            zoom.zoom_operator,
            zoom.lmmse_operator,
            zoom_kernels._kernel_solver,
            zoom_kernels._scene,
            zoom_kernels._far,
            zoom_kernels._window,
            zoom_kernels._tables,
            zoom_kernels._borders,
            zoom_kernels._border_kernels,
            zoom_kernels._short_rows,
            zoom_kernels.spline_prefilter,
        ):
            remembered.cache_clear()

    forget()
    yield forget
    keep_kernels(None)
    forget()


def _weights(psf: Psf, ratio: float, model: Model) -> list[FloatArray]:
    operator = zoom.zoom_operator(SHAPE, SamplingGrid.centred(SHAPE, ratio), psf, model)
    return [m.weights for stage in operator.stages for term in stage.terms for m in term]


@pytest.mark.parametrize(
    ("psf", "ratio", "model"),
    [(SOFT, 1.3, "lmmse"), (LENS, 1.6, "lmmse"), (LENS, 1.6, "matched")],
)
def test_kernels_from_disk_are_those_designed_to_the_bit(
    cache: DesignCache, forgotten: Callable[[], None], psf: Psf, ratio: float, model: Model
) -> None:
    designed = _weights(psf, ratio, model)
    forgotten()
    keep_kernels(cache)
    stored = _weights(psf, ratio, model)
    forgotten()
    keep_kernels(lambda name, _: cache(name, _never))
    read = _weights(psf, ratio, model)
    for new, first, again in zip(designed, stored, read, strict=True):
        assert new.tobytes() == first.tobytes() == again.tobytes()


def test_what_is_kept_is_not_designed_again(cache: DesignCache) -> None:
    designed = cache("a", _design(1.5))
    for array, back in zip(designed, cache("a", _never), strict=True):
        np.testing.assert_array_equal(array, back)


def test_another_name_is_another_design(cache: DesignCache) -> None:
    cache("a", _design(1.0))
    assert cache("b", _design(2.0))[0][0] == 2.0
    assert cache("a", _never)[0][0] == 1.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: b"no kernels at all",
        lambda data: data[:-1],
        lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:],
    ],
    ids=["empty", "foreign", "cut short", "one bit"],
)
def test_a_damaged_or_foreign_file_is_ignored_and_replaced(
    cache: DesignCache, spoil: Callable[[bytes], bytes]
) -> None:
    cache("a", _design(1.0))
    (path,) = cache.folder.iterdir()
    path.write_bytes(spoil(path.read_bytes()))
    assert cache("a", _design(1.0))[0][0] == 1.0
    assert cache("a", _never)[0][0] == 1.0


def test_a_whole_file_of_another_design_is_ignored_and_replaced(cache: DesignCache) -> None:
    cache("a", _design(1.0))
    (of_a,) = cache.folder.iterdir()
    cache("b", _design(2.0))
    (of_b,) = set(cache.folder.iterdir()) - {of_a}
    of_b.write_bytes(of_a.read_bytes())
    assert cache("b", _design(2.0))[0][0] == 2.0
    assert cache("b", _never)[0][0] == 2.0


def test_a_file_is_written_as_a_whole_or_not_at_all(
    cache: DesignCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_part: Path, _path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        cache("a", _design(1.0))
    assert list(cache.folder.iterdir()) == []


def test_the_least_recently_used_designs_make_room(tmp_path: Path) -> None:
    whole = DesignCache(tmp_path / "whole", PLENTY, _silent)
    whole("a", _design(0.0, 1000))
    (path,) = whole.folder.iterdir()
    cache = DesignCache(tmp_path / "limited", 2.5 * path.stat().st_size, _silent)
    names: dict[str, Path] = {}
    for age_s, name in ((300, "a"), (200, "b")):
        before = set(cache.folder.iterdir()) if names else set()
        cache(name, _design(0.0, 1000))
        (names[name],) = set(cache.folder.iterdir()) - before
        long_ago = names[name].stat().st_mtime - age_s
        os.utime(names[name], (long_ago, long_ago))
    cache("a", _never)  # is used now, and b longest ago
    cache("c", _design(0.0, 1000))
    assert names["a"].exists()
    assert not names["b"].exists()
    assert sum(p.stat().st_size for p in cache.folder.iterdir()) <= 2.5 * path.stat().st_size


def test_a_design_larger_than_the_limit_is_not_kept(tmp_path: Path) -> None:
    cache = DesignCache(tmp_path / "small", 1000, _silent)
    assert len(cache("a", _design(1.0, 1000))[0]) == 1000
    assert not cache.folder.exists()


def test_a_folder_that_cannot_be_written_costs_one_remark(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    remarks: list[str] = []
    cache = DesignCache(tmp_path / "file", PLENTY, remarks.append)
    assert cache("a", _design(1.0))[0][0] == cache("b", _design(1.0))[0][0] == 1.0
    (remark,) = remarks
    assert str(tmp_path / "file") in remark
    assert FOLDER_VARIABLE in remark


def test_a_folder_in_a_files_place_costs_one_remark(tmp_path: Path) -> None:
    remarks: list[str] = []
    cache = DesignCache(tmp_path, PLENTY, remarks.append)
    cache("a", _design(1.0))
    (path,) = tmp_path.iterdir()
    path.unlink()
    path.mkdir()
    assert cache("a", _design(1.0))[0][0] == 1.0
    assert len(remarks) == 1


def test_many_at_once_read_and_write_whole_designs_only(tmp_path: Path) -> None:
    def work(seed: int) -> bool:
        # Each with a cache of its own, as in a process of its own; the limit holds four of nine.
        cache = DesignCache(tmp_path, 100_000, _silent)
        values = np.random.default_rng(seed).integers(9, size=60).tolist()
        return all(
            np.array_equal(array, expected)
            for value in values
            for array, expected in zip(
                cache(str(value), _design(value, 1000)), _design(value, 1000)(), strict=True
            )
        )

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(work, range(8)))
    assert not list(tmp_path.glob("*.part"))


def test_other_code_libraries_or_processors_have_designs_of_their_own(
    cache: DesignCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache("a", _design(1.0))
    monkeypatch.setattr(design_cache, "_made_by", lambda: "another processor")
    assert cache("a", _design(2.0))[0][0] == 2.0


def _names(*psfs: Psf) -> list[str]:
    names: list[str] = []

    def keeper(name: str, design: Callable[[], Arrays]) -> Arrays:
        names.append(name)
        return design()

    keep_kernels(keeper)
    for psf in psfs:
        kept("test", (psf, 1.3), _design(0.0))
    return names


def test_every_number_of_a_psf_is_part_of_the_name(forgotten: Callable[[], None]) -> None:
    rows = np.zeros((1, CORRECTION_SPLINES))
    corrected = []
    for place in range(CORRECTION_SPLINES):
        row = rows[0].copy()
        row[place] = 1e-300
        correction = OtfCorrection(coefficients=(tuple(row.tolist()),))
        corrected.append(MeasuredPsf(lens=LensOtf(correction=correction), gaussian=SOFT))
    psfs: list[Psf] = [SOFT, GaussianPsf(np.nextafter(0.7, 1), 0.6), LENS, *corrected]
    assert len(set(_names(*psfs))) == len(psfs)


def test_kernels_of_a_psf_from_another_package_are_not_kept(forgotten: Callable[[], None]) -> None:
    @dataclass(frozen=True)
    class Foreign:
        gaussian: GaussianPsf = SOFT
        form: Literal["gaussian"] = "gaussian"
        covariance_px2 = SOFT.covariance_px2

        def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
            return SOFT.otf(fx_cy_per_px, fy_cy_per_px)

    assert _names(Foreign()) == []


@pytest.fixture
def kept_by_the_environment(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    design_cache.keep_designs_on_disk.cache_clear()
    for name in (FOLDER_VARIABLE, LIMIT_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    yield
    keep_kernels(None)
    design_cache.keep_designs_on_disk.cache_clear()


@pytest.mark.usefixtures("kept_by_the_environment")
@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({}, "home/.cache/standoff/designs"),
        ({"XDG_CACHE_HOME": "{}/xdg"}, "xdg/standoff/designs"),
        ({FOLDER_VARIABLE: "{}/own"}, "own"),
        ({FOLDER_VARIABLE: "{}/own", LIMIT_VARIABLE: "0"}, None),
    ],
)
def test_the_environment_says_where_and_whether_designs_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], folder: str | None
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name, value in variables.items():
        monkeypatch.setenv(name, value.format(tmp_path))
    design_cache.keep_designs_on_disk()
    kept("test", (1.0,), _design(1.0))
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path.parent for path in written] == ([] if folder is None else [tmp_path / folder])


@pytest.mark.usefixtures("kept_by_the_environment")
@pytest.mark.parametrize("text", ["much", "-1", "nan"])
def test_a_limit_that_is_no_number_is_named_and_the_default_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, text: str
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setenv(LIMIT_VARIABLE, text)
    with caplog.at_level(logging.WARNING, "standoff"):
        design_cache.keep_designs_on_disk()
    assert LIMIT_VARIABLE in caplog.text
    assert repr(text) in caplog.text
    assert "256" in caplog.text


@pytest.mark.slow
def test_a_command_keeps_its_designs_and_the_next_writes_the_same_image(tmp_path: Path) -> None:
    near = np.random.default_rng(0).uniform(0, 200, (60, 80)).astype(np.float32)
    script = (
        "import numpy as np, standoff, sys;"
        "psf = standoff.GaussianPsf(0.8, 0.7);"
        "far = standoff.simulate(np.load('near.npy'), zoom=1.3, psf=psf);"
        "np.save(sys.argv[1], far.image)"
    )
    np.save(tmp_path / "near.npy", near)
    environment = os.environ | {FOLDER_VARIABLE: str(tmp_path / "designs"), LIMIT_VARIABLE: "1"}
    for name in ("first", "second"):
        subprocess.run(
            [sys.executable, "-c", script, name],
            cwd=tmp_path,
            env=environment,
            check=True,
        )
        assert list((tmp_path / "designs").glob("*.kernels"))
    assert (tmp_path / "first.npy").read_bytes() == (tmp_path / "second.npy").read_bytes()
