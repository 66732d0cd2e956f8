"""An edge of known width comes back from every format: the whole of what the reader is for.

The truth is the error function along the normal, in light. Both sides of the edge lie on whole
codes of the encoding; beyond that 8 bits round where they must.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.photographs._encoding import LINEAR
from acquisition.photographs._photograph import Photograph
from acquisition.photographs._reader import ReadOptions
from calibration.edges import EdgeImage, edges_of_image, plane_places
from simulation.arrays import FloatArray
from tests.acquisition.photographs.made import (
    CELLS,
    DISPLAY_P3,
    Dng,
    Pixels,
    gamma_curve,
    icc_chunk,
    pillow,
    png,
    profile,
    read,
    tiff,
)
from tests.acquisition.photographs.test_scientific import exr, fits
from tests.calibration.closed_form import edge_image

DARK, BRIGHT = 60 / 255, 240 / 255
"""Codes of the two sides, of white."""

SHAPE = (600, 640)
ANGLE_DEG = 5.0
NEAR = 0.005
ADOBE = profile(gamma_curve(2.2), space=b"GRAY")

Curve = Callable[[FloatArray], FloatArray]


def srgb_light(code: FloatArray) -> FloatArray:
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def srgb_code(light: FloatArray) -> FloatArray:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def as_it_is(light: FloatArray) -> FloatArray:
    return light


def codes(sigma_px: float, to_light: Curve, to_code: Curve) -> FloatArray:
    """Codes from 0 to 1 of an edge whose light is blurred by a Gaussian."""
    dark, bright = to_light(np.array([DARK, BRIGHT])).tolist()
    light = edge_image(sigma_px, ANGLE_DEG, shape=SHAPE, low_dn=dark, high_dn=bright)
    return to_code(light)


def whole(levels: FloatArray, kind: type[np.unsignedinteger[Any]]) -> Pixels:
    return np.rint(levels * np.iinfo(kind).max).astype(kind)


def srgb_bytes(sigma_px: float, dither_dn: float = 0.0) -> Pixels:
    noise = np.random.default_rng(1).normal(0.0, dither_dn / 255, SHAPE)
    return whole(codes(sigma_px, srgb_light, srgb_code) + noise, np.uint8)


def widths_px(found: Photograph, plane: FloatArray | None = None, pitch_px: int = 1) -> FloatArray:
    """Total sigma of each edge found, which are parts of the one."""
    measured = edges_of_image(
        EdgeImage(
            name=found.name,
            image_dn=found.grey_dn if plane is None else plane,
            saturation_dn=found.saturation_dn,
            is_jpeg=found.is_jpeg,
            pitch_px=pitch_px,
        )
    )
    return np.array([edge.sigma_px for edge in measured])


def g22_tiff(sigma_px: float, _: Path) -> bytes:
    code = codes(sigma_px, lambda x: x**2.2, lambda x: x ** (1 / 2.2))
    return tiff(whole(code, np.uint8), iccprofile=ADOBE)


def linear(sigma_px: float) -> FloatArray:
    return codes(sigma_px, as_it_is, as_it_is)


FORMATS: dict[str, Callable[[float, Path], bytes]] = {
    "8-bit PNG": lambda sigma, _: png(srgb_bytes(sigma)),
    "8-bit PNG in Display P3": lambda sigma, _: png(
        np.dstack([srgb_bytes(sigma)] * 3), icc_chunk(DISPLAY_P3)
    ),
    "8-bit TIFF of gamma 2.2": g22_tiff,
    "8-bit TIFF": lambda sigma, _: tiff(whole(linear(sigma), np.uint8)),
    "16-bit TIFF": lambda sigma, _: tiff(whole(linear(sigma), np.uint16), compression="zstd"),
    "16-bit PNG": lambda sigma, _: png(whole(linear(sigma), np.uint16)),
    "16-bit PNG in sRGB": lambda sigma, _: png(
        whole(codes(sigma, srgb_light, srgb_code), np.uint16), (b"sRGB", b"\0")
    ),
    "float TIFF": lambda sigma, _: tiff(linear(sigma).astype(np.float32)),
    "OpenEXR": lambda sigma, folder: exr(folder, {"Y": linear(sigma).astype(np.float32)}),
    "FITS": lambda sigma, _: fits(whole(linear(sigma), np.uint16)),
}


@pytest.mark.slow
@pytest.mark.parametrize("sigma_px", [0.8, 1.2])
@pytest.mark.parametrize("kind", FORMATS)
def test_each_edge_has_its_width_in_every_format(
    tmp_path: Path, kind: str, sigma_px: float
) -> None:
    found = widths_px(read(tmp_path, FORMATS[kind](sigma_px, tmp_path)))
    assert len(found) > 1
    # Found: 0.13 % at most in 8 bits, 0.001 % in more.
    np.testing.assert_allclose(found, sigma_px, rtol=0.002 if "8-bit" in kind else 1e-4)


@pytest.mark.parametrize("sigma_px", [0.8, 1.2])
def test_a_jpeg_with_noise_of_one_code_has_the_width_on_average(
    tmp_path: Path, sigma_px: float
) -> None:
    # The noise breaks the steps of quantisation: each edge is within 0.44 %, their mean 0.03 %.
    data = pillow(srgb_bytes(sigma_px, dither_dn=1.0), "JPEG", quality=95)
    found = widths_px(read(tmp_path, data))
    assert found.mean() == pytest.approx(sigma_px, rel=NEAR)
    np.testing.assert_allclose(found, sigma_px, rtol=2 * NEAR)


@pytest.mark.slow
@pytest.mark.parametrize("sigma_px", [0.8, 1.2])
def test_a_jpeg_without_noise_is_as_good_as_its_quantisation(
    tmp_path: Path, sigma_px: float
) -> None:
    # Without noise, quality 95 rounds all blocks along the edge alike: up to -1.5 % for one
    # edge and -0.5 % on average.
    found = widths_px(read(tmp_path, pillow(srgb_bytes(sigma_px), "JPEG", quality=95)))
    assert found.mean() == pytest.approx(sigma_px, rel=0.006)
    np.testing.assert_allclose(found, sigma_px, rtol=0.02)


@pytest.mark.parametrize("pattern", CELLS)
def test_a_mosaic_has_the_width_in_all_of_its_planes(tmp_path: Path, pattern: str) -> None:
    levels = np.rint(64 + 3900 * linear(0.8)).astype(np.uint16)
    found = read(tmp_path, Dng(levels=levels, cells=CELLS[pattern]).to_bytes(), name="a.dng")
    assert found.pattern == pattern
    mosaic = found.linear_planes.astype(np.float64)
    np.testing.assert_allclose(widths_px(found, mosaic), 0.8, rtol=NEAR)
    for place in plane_places(found.pattern):
        np.testing.assert_allclose(widths_px(found, place.plane(mosaic), 2), 0.8, rtol=NEAR)


def test_encoded_levels_that_are_taken_for_light_are_far_off(tmp_path: Path) -> None:
    # What the encoding is worth: an edge in sRGB seems narrower or wider by percents.
    taken = read(tmp_path, png(srgb_bytes(0.8)), ReadOptions(encoding=LINEAR))
    assert abs(widths_px(taken).mean() / 0.8 - 1) > 10 * NEAR
