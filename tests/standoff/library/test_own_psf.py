"""PSFs of one's own in files, from the function and from the command line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import standoff
from calibration.errors import PsfFileError
from simulation.arrays import FloatArray
from standoff.library.psf import is_own_psf, read_own_psf
from tests.standoff.conftest import Command

SIGMA_PX = 0.8
EQUAL = standoff.GaussianPsf(sigma_px=SIGMA_PX)


def kernel(samples_per_px: float) -> FloatArray:
    y, x = np.mgrid[:47, :45]
    square = (x - 21.7) ** 2 + (y - 24.1) ** 2
    return np.asarray(np.exp(-0.5 * square / (SIGMA_PX * samples_per_px) ** 2))


def scene() -> FloatArray:
    y, x = np.mgrid[:96, :128]
    return np.asarray(1000 + 400 * np.sin(0.5 * x) * np.cos(0.4 * y) + 300 * (x > 60))


def as_npy(folder: Path) -> Path:
    np.save(folder / "kernel.npy", kernel(4))
    path = folder / "lens.toml"
    path.write_text('kernel = "kernel.npy"\nsamples_per_px = 4\n', encoding="utf-8")
    return path


def as_fits(folder: Path, **header: object) -> Path:
    fits = pytest.importorskip("astropy.io.fits")
    unit = fits.PrimaryHDU(kernel(4))
    unit.header.update(header or {"OVERSAMP": 4})
    path = folder / "kernel.fits"
    unit.writeto(path, overwrite=True)
    return path


def as_psfex(folder: Path) -> Path:
    return as_fits(folder, PSF_SAMP=0.25)


def as_csv(folder: Path) -> Path:
    freq = np.linspace(0, 2, 201)
    rows = np.column_stack([freq, np.exp(-2 * (np.pi * SIGMA_PX * freq) ** 2)])
    path = folder / "mtf.csv"
    np.savetxt(path, rows, delimiter=",", header="freq_cy_per_px,mtf", comments="")
    return path


@pytest.mark.parametrize("written", [as_npy, as_fits, as_psfex, as_csv])
def test_a_gaussian_in_any_file_is_the_gaussian(
    written: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = written(tmp_path)
    found = standoff.simulate(scene(), zoom=1.5, psf=path)
    expected = standoff.simulate(scene(), zoom=1.5, psf=EQUAL)
    np.testing.assert_allclose(found.image, expected.image, atol=0.5)
    assert any(path.name in note for note in found.notes)


def test_a_wavefront_in_a_file_is_that_of_its_coefficients(tmp_path: Path) -> None:
    path = tmp_path / "lens.toml"
    path.write_text("cut_off_period_px = 0.4\nzernike_waves = {4 = 0.1, 8 = 0.05}\n")
    said: list[str] = []
    psf = read_own_psf(path, said.append)
    assert psf == standoff.TabulatedPsf.from_zernike({4: 0.1, 8: 0.05}, cut_off_period_px=0.4)
    assert "not symmetric" in said[0]
    assert "is left out" in said[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kernel = 3", "kernel"),
        ('kernl = "k.npy"', "did you mean kernel"),
        ("samples_per_px = 2", "one of kernel, mtf, pupil and zernike_waves"),
        ('kernel = "k.npy"\nmtf = "m.csv"', "got kernel and mtf"),
        ('pupil = "k.npy"', "pupil needs cut_off_period_px"),
        ("cut_off_period_px = -1", "cut_off_period_px"),
        ('kernel = "missing.npy"', "No such file"),
        ("zernike_waves = {x = 1}\ncut_off_period_px = 1", "zernike_waves"),
        ("zernike_waves = {0 = 1}\ncut_off_period_px = 1", "Noll's numbers"),
        ("[", "not valid TOML"),
    ],
)
def test_a_description_that_is_none_is_refused_by_its_file(
    text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "lens.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PsfFileError, match=message) as caught:
        standoff.simulate(scene(), zoom=1.5, psf=path)
    assert "lens.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("k.npy", b"no array"),
        ("k.tif", b"II*\0"),
        ("k.fits", b"SIMPLE  ="),
        ("m.csv", b"freq,mtf\n0,1\n0.1\n"),
        ("m.csv", b"freq,mtf\n0,one\n"),
        ("m.csv", b""),
        ("m.csv", b"\xff\xfe"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert is_own_psf(path)
    with pytest.raises(PsfFileError, match=name) as caught:
        read_own_psf(path)
    assert "\n" not in str(caught.value)


def test_every_command_with_a_psf_takes_one_of_ones_own(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    rng = np.random.default_rng(4)
    for number in range(2):
        levels = 20_000 + 4_000 * rng.standard_normal((24, 32)).repeat(8, 0).repeat(8, 1)
        standoff_tiff(photographs / f"{number}.tif", levels)
    psf, first = as_npy(tmp_path), photographs / "0.tif"
    for run in (
        f"simulate {first} --zoom 1.5 --out far.tif",
        f"changes {first} {first} --out changes",
        f"detectability {photographs} --noise 200 --contrast 2000 --zooms 1,1.5 --out curves.json",
        f"evaluate ssim --photographs {photographs} --noise 200 --contrast 2000 --zooms 1,1.5 "
        "--out evaluation.json",
        f"sr-pairs {photographs} --zoom 2 --out pairs",
        f"change-pairs {photographs} --zooms 1,1.5 --noise 200 --out change-pairs",
    ):
        done = command(*run.split(), "--encoding", "linear", "--psf", psf)
        assert done.status == 0, (run, done.err)
        assert "lens.toml" in done.err, run


def standoff_tiff(path: Path, levels: FloatArray) -> None:
    import tifffile

    tifffile.imwrite(path, np.clip(levels, 0, 65_535).astype(np.uint16))
