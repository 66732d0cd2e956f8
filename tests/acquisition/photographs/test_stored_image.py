"""What a file says of itself: its Exif tags, and how another one is coded as it is."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image

from acquisition.photographs import read_photograph
from acquisition.photographs._stored_image import PhotographFacts, is_srgb
from tests.acquisition.photographs.made import (
    COLOUR,
    GREY,
    ascii_tag,
    pillow,
    ratio_tag,
    read,
    short_tag,
    tiff_with_exif,
)
from tests.shipped import shipped

FACTS = PhotographFacts(
    camera="Canon EOS 5D",
    lens="EF50mm f/1.4 USM",
    focal_length_mm=50.0,
    f_number=5.6,
    exposure_s=1 / 160,
    iso=200.0,
    pixel_pitch_um=6.35,  # 4000 pixels an inch: 25.4 mm / 4000
    taken="2026:11:22 10:00:00",
    orientation=6,
)


def pillow_tags(**changes: Any) -> Image.Exif:
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "Canon", "Canon EOS 5D", 6
    own = exif.get_ifd(0x8769)
    own |= {0x829A: 1 / 160, 0x829D: 5.6, 0x8827: 200, 0x9003: "2026:11:22 10:00:00"}
    own |= {0x920A: 50.0, 0xA002: COLOUR.shape[1], 0xA20E: 4000.0, 0xA210: 2}
    own |= {0xA434: "EF50mm f/1.4 USM"}
    own |= {int(number[1:], 16): value for number, value in changes.items()}
    return exif


def made_tiff() -> bytes:
    main = [ascii_tag(0x010F, "Canon"), ascii_tag(0x0110, "Canon EOS 5D"), short_tag(0x0112, 6)]
    own = [
        ratio_tag(0x829A, 1, 160),
        ratio_tag(0x829D, 56, 10),
        short_tag(0x8827, 200),
        ascii_tag(0x9003, "2026:11:22 10:00:00"),
        ratio_tag(0x920A, 50, 1),
        short_tag(0xA002, GREY.shape[1]),
        ratio_tag(0xA20E, 4000, 1),
        short_tag(0xA210, 2),
        ascii_tag(0xA434, "EF50mm f/1.4 USM"),
        short_tag(0xABCD, 7),  # nobody's
    ]
    return tiff_with_exif(main, own)


@pytest.mark.parametrize(
    "made",
    [
        lambda: pillow(COLOUR, "JPEG", exif=pillow_tags()),
        lambda: pillow(COLOUR, "PNG", exif=pillow_tags()),
        lambda: pillow(COLOUR, "WEBP", exif=pillow_tags(), lossless=True),
        made_tiff,
    ],
    ids=["JPEG", "PNG", "WebP", "TIFF"],
)
def test_every_format_tells_what_the_camera_wrote(
    tmp_path: Path, made: Callable[[], bytes]
) -> None:
    found = read(tmp_path, made()).facts
    # Pillow writes a ratio near to the float.
    assert found.to_json() == {
        name: pytest.approx(value, rel=1e-6) if isinstance(value, float) else value
        for name, value in FACTS.to_json().items()
    }
    assert found.turn == "turned by 90 degrees clockwise"


def test_pixels_are_never_turned(tmp_path: Path) -> None:
    for number in range(1, 9):
        found = read(tmp_path, pillow(COLOUR, "PNG", exif=pillow_tags(x0112=number)))
        np.testing.assert_array_equal(found.stored, COLOUR)


def test_an_image_that_was_scaled_has_no_pixel_pitch(tmp_path: Path) -> None:
    scaled = pillow_tags(xA002=2 * COLOUR.shape[1])
    assert read(tmp_path, pillow(COLOUR, "JPEG", exif=scaled)).facts.pixel_pitch_um is None


@pytest.mark.parametrize(
    ("unit", "pitch_um"),
    # Exif 3.0, 4.6.6: inch is usual, 3 is cm; TIFF/EP has mm and µm as well.
    [(None, 6.35), (2, 6.35), (3, 2.5), (4, None), (5, None), (1, None), (9, None)],
)
def test_the_pitch_follows_from_the_resolution_and_its_unit(
    unit: int | None, pitch_um: float | None
) -> None:
    tags = {0xA20E: (4000, 1)} | ({} if unit is None else {0xA210: unit})
    assert PhotographFacts.of_tags(tags, 52).pixel_pitch_um == (
        None if pitch_um is None else pytest.approx(pitch_um)
    )


@pytest.mark.parametrize(
    "odd", [b"\xff\0", "", "5.6", (), (1, 0), (0, 0), -1, 0, float("nan"), float("inf"), {}, None]
)
def test_an_odd_tag_says_nothing(odd: object) -> None:
    numbers = (0x829A, 0x829D, 0x8827, 0x920A, 0x0112, 0xA20E)
    found = PhotographFacts.of_tags(dict.fromkeys(numbers, odd), 52)
    kept = {"iso"} if odd == (1, 0) else set()  # two numbers, of which the first is the speed
    # Orientation 1, of (1, 0), is one.
    assert set(found.to_json()) <= kept | ({"orientation"} if kept else set())


def test_the_first_of_two_sensitivities_counts() -> None:
    # PhotographicSensitivity may hold several: they are no ratio.
    assert PhotographFacts.of_tags({0x8827: (100, 200)}, 52).iso == 100


def test_the_first_of_two_ratios_counts() -> None:
    assert PhotographFacts.of_tags({0x829D: (28, 10, 40, 10)}, 52).f_number == 2.8


values = st.recursive(
    st.none() | st.integers() | st.floats() | st.text() | st.binary() | st.booleans(),
    lambda inner: st.lists(inner, max_size=3).map(tuple),
    max_leaves=4,
)


@pytest.mark.slow
@given(st.dictionaries(st.sampled_from([*range(0x010F, 0x0133), 0x829A, 0x829D, 0x8827, 0x9003,
       0x920A, 0xA001, 0xA002, 0xA20E, 0xA210, 0xA433, 0xA434]), values))  # fmt: skip
def test_no_tag_is_too_odd(tags: dict[int, Any]) -> None:
    found = PhotographFacts.of_tags(tags, 52)
    assert all(str(value).isprintable() for value in found.to_json().values())
    assert is_srgb(tags) in (True, False)


def test_texts_hold_nothing_that_a_terminal_obeys() -> None:
    tags = {0x0110: "A\x1b[31m\nB\0rest", 0xA434: b"C\xff\r"}
    found = PhotographFacts.of_tags(tags, 52)
    assert found.camera == "A[31mB"
    assert found.lens is not None
    assert found.lens.startswith("C")
    assert all(str(value).isprintable() for value in found.to_json().values())


def test_the_make_is_not_said_twice() -> None:
    cases = [("NIKON CORPORATION", "NIKON D850", "NIKON D850"), ("SONY", "ILCE-7", "SONY ILCE-7")]
    for make, model, camera in cases:
        assert PhotographFacts.of_tags({0x010F: make, 0x0110: model}, 52).camera == camera


def saved(path: Path, name: str, **how: Any) -> Path:
    Image.fromarray(shipped(name)[:200, :240].astype(np.uint8)).save(path, **how)
    return path


@pytest.mark.parametrize("name", ["astronaut", "camera"])
@pytest.mark.parametrize("quality", [60, 75, 90, 98])
@pytest.mark.parametrize("subsampling", [0, 1, 2])
def test_a_png_coded_as_its_jpeg_is_that_jpeg(
    tmp_path: Path, name: str, quality: int, subsampling: int
) -> None:
    png = read_photograph(saved(tmp_path / "a.png", name))
    how = {"subsampling": subsampling} if name == "astronaut" else {}
    jpeg = read_photograph(saved(tmp_path / "a.jpg", name, quality=quality, **how))
    assert np.array_equal(png.coded_as(jpeg).stored, jpeg.stored)
    assert not np.array_equal(png.stored, jpeg.stored)


def test_the_coarser_file_stays_as_it_is(tmp_path: Path) -> None:
    fine, coarse = (
        read_photograph(saved(tmp_path / f"{quality}.jpg", "astronaut", quality=quality))
        for quality in (95, 75)
    )
    assert coarse.coded_as(fine) is coarse
    assert fine.coded_as(coarse) is not fine
    assert fine.coded_as(fine) is fine


def test_a_jpeg_coded_as_another_does_not_lose_the_colour_of_small_things(tmp_path: Path) -> None:
    scene = np.full((160, 160, 3), (190, 235, 190), dtype=np.uint8)
    for row in range(12, 150, 22):
        for col in range(12, 150, 21):
            scene[row : row + 5, col : col + 5] = 230, 25, 22
    for quality in (100, 95):
        Image.fromarray(scene).save(tmp_path / f"{quality}.jpg", quality=quality, subsampling=2)
    fine, coarse = (read_photograph(tmp_path / f"{quality}.jpg") for quality in (100, 95))
    coded = fine.coded_as(coarse).stored.astype(np.float64)
    is_red = scene[..., 0] == 230
    assert np.any(coded != fine.stored)
    # Twice halved, the patches lost 18 levels of red.
    assert np.mean(coded[is_red], axis=0) == pytest.approx(
        np.mean(fine.stored[is_red], axis=0), abs=1.5
    )


def test_levels_of_another_kind_are_not_coded(tmp_path: Path) -> None:
    jpeg = read_photograph(saved(tmp_path / "a.jpg", "astronaut", quality=75))
    grey = read_photograph(saved(tmp_path / "grey.png", "camera"))
    deep = tmp_path / "deep.png"
    Image.fromarray(shipped("camera").astype(np.uint16) * 257).save(deep)
    for other in (grey, read_photograph(deep)):
        assert other.coded_as(jpeg) is other
        assert jpeg.coded_as(other) is jpeg


def test_a_step_in_grey_is_that_of_the_channels_in_their_luma(tmp_path: Path) -> None:
    # A grey of 188 in sRGB: its next level is 1.7 levels of linear light further on.
    Image.fromarray(np.full((20, 30), 188, dtype=np.uint8)).save(tmp_path / "grey.png")
    grey = read_photograph(tmp_path / "grey.png").file_steps.step_dn
    assert grey is not None
    by_hand = (
        255 * (((189 / 255 + 0.055) / 1.055) ** 2.4 - ((187 / 255 + 0.055) / 1.055) ** 2.4) / 2
    )
    np.testing.assert_allclose(grey, by_hand, rtol=1e-4)
    Image.fromarray(np.full((20, 30, 3), 188, dtype=np.uint8)).save(tmp_path / "colour.png")
    colour = read_photograph(tmp_path / "colour.png").file_steps.step_dn
    assert colour is not None
    weights = np.sqrt(0.299**2 + 0.587**2 + 0.114**2)
    np.testing.assert_allclose(colour, weights * by_hand, rtol=1e-4)
