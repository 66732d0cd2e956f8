from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from analysis.choices import CACHE_VARIABLE
from analysis.errors import ResultsFileError
from analysis.validation.kernel_cache import KernelCache, default_cache_folder
from simulation.kernelgan import EstimatedKernel, KernelGanSettings

IMAGE = np.random.default_rng(0).uniform(0, 1, (20, 30))
SETTINGS = KernelGanSettings(zoom=2.0)


def _kernel() -> EstimatedKernel:
    weights = np.zeros((13, 13))
    weights[6, 5:8] = 0.25, 0.5, 0.25
    return EstimatedKernel(weights=weights)


def test_a_stored_kernel_comes_back_and_has_a_picture(tmp_path: Path) -> None:
    cache = KernelCache(tmp_path / "new" / "folder")
    assert cache.load(IMAGE, SETTINGS) is None
    path = cache.store(IMAGE, SETTINGS, _kernel())
    back = cache.load(IMAGE, SETTINGS)
    assert back is not None
    np.testing.assert_array_equal(back.weights, _kernel().weights)
    with Image.open(path.with_suffix(".png")) as picture:
        assert picture.size == (208, 208)
        assert picture.getpixel((6 * 16, 6 * 16)) == 255
    assert {p.suffix for p in cache.folder.iterdir()} == {".npy", ".png"}


def test_other_pixels_or_settings_are_another_kernel(tmp_path: Path) -> None:
    cache = KernelCache(tmp_path)
    others = [
        cache.path(IMAGE + 1e-9, SETTINGS),
        cache.path(IMAGE.reshape(30, 20), SETTINGS),
        cache.path(IMAGE.astype(np.float32), SETTINGS),
        cache.path(IMAGE, replace(SETTINGS, zoom=2.1)),
        cache.path(IMAGE, replace(SETTINGS, model="gaussian-kernelgan")),
        cache.path(IMAGE, replace(SETTINGS, steps=4000)),
        cache.path(IMAGE, replace(SETTINGS, seed=1)),
        cache.path(IMAGE, replace(SETTINGS, is_centre_crop=True)),
    ]
    assert len({cache.path(IMAGE, SETTINGS), *others}) == 1 + len(others)


@pytest.mark.parametrize("content", [b"", b"no kernel", None])
def test_a_damaged_kernel_counts_as_none(tmp_path: Path, content: bytes | None) -> None:
    cache = KernelCache(tmp_path)
    path = cache.store(IMAGE, SETTINGS, _kernel())
    if content is None:
        np.save(path, np.zeros((13, 13)))
    else:
        path.write_bytes(content)
    assert cache.load(IMAGE, SETTINGS) is None


def test_a_folder_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    cache = KernelCache(tmp_path / "file")
    with pytest.raises(ResultsFileError) as refused:
        cache.store(IMAGE, SETTINGS, _kernel())
    assert refused.value.source == str(cache.path(IMAGE, SETTINGS))


def test_the_folder_follows_the_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert default_cache_folder() == tmp_path / "home/.cache/standoff/kernels"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert default_cache_folder() == tmp_path / "xdg/standoff/kernels"
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "own"))
    assert default_cache_folder() == tmp_path / "own"


def test_a_stored_kernel_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    cache = KernelCache(tmp_path)
    path = cache.path(IMAGE, SETTINGS)
    path.mkdir()
    with pytest.raises(ResultsFileError) as refused:
        cache.load(IMAGE, SETTINGS)
    assert refused.value.source == str(path)
    assert isinstance(refused.value.__cause__, IsADirectoryError)
