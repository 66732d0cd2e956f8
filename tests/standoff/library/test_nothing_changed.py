"""What everybody tries first: a photograph and a copy of it, and the same scene photographed twice.

The pictures are scikit-image's. A comparison states how many pixels chance flags in a frame, 0.05.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from skimage import data

import standoff
from analysis.changes import ChangeSummary, describe_focus
from simulation.arrays import FloatArray
from simulation.choices import MODELS, POSE_MODELS
from tests.shipped import shipped

PICTURES = ("astronaut", "camera", "page", "retina")
COPIES = ("png", "tif", "unmarked", 75, 90, 98)


def part(name: str) -> FloatArray:
    return shipped(name)[:360, :380]


def written(path: Path, levels: FloatArray, quality: int | None = None) -> Path:
    picture = Image.fromarray(np.clip(np.rint(levels), 0, 255).astype(np.uint8))
    if quality is None:
        marked: dict[str, Any] = {"icc_profile": SRGB} if path.name == "after.tif" else {}
        picture.save(path, **marked)
    else:
        picture.save(path, quality=quality)
    return path


def srgb_profile() -> bytes:
    from PIL.ImageCms import ImageCmsProfile, createProfile

    return ImageCmsProfile(createProfile("sRGB")).tobytes()


SRGB = srgb_profile()


def found(before: Path, after: Path) -> ChangeSummary:
    return standoff.find_changes(before, after).summary


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("copy", COPIES)
def test_a_copy_is_no_change_and_as_sharp(tmp_path: Path, name: str, copy: str | int) -> None:
    before = written(tmp_path / "before.png", part(name))
    if isinstance(copy, int):
        after = written(tmp_path / "after.jpg", part(name), copy)
    else:
        # Unmarked, a TIFF of 8 bits would be linear.
        after = written(
            tmp_path / {"unmarked": "unmarked.tif"}.get(copy, f"after.{copy}"), part(name)
        )
    for one, other in ((before, after), (after, before)):
        summary = found(one, other)
        assert (summary.changes, summary.moved) == ((), ())
        # Drawn by nobody's chance: the copies' errors are those of their files alone.
        assert abs(summary.gain - 1) <= 3 * summary.gain_err + 1e-6
        assert "as sharp as" in str(describe_focus(summary))


def test_two_jpegs_of_a_picture_are_as_sharp_and_as_bright(tmp_path: Path) -> None:
    softer, brighter = list[str](), list[str]()
    for name in PICTURES:
        for qualities in ((75, 90), (95, 85)):
            before, after = (
                written(tmp_path / f"{side}.jpg", part(name), quality)
                for side, quality in zip(("before", "after"), qualities, strict=True)
            )
            summary = found(before, after)
            assert (summary.changes, summary.moved) == ((), ())
            if "as sharp as" not in str(describe_focus(summary)):
                softer.append(f"{name} {qualities}")
            if abs(summary.gain - 1) > 3 * summary.gain_err:
                brighter.append(f"{name} {qualities}")
    # 3 to 4 % of such pairs are not within three errors.
    assert len(softer) <= 1, softer
    assert len(brighter) <= 1, brighter


@pytest.mark.parametrize("name", PICTURES)
def test_from_where_it_was_taken_a_photograph_is_itself(name: str) -> None:
    psf = standoff.GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)
    for model in MODELS:
        seen = standoff.simulate(part(name), zoom=1, psf=psf, model=model).image
        np.testing.assert_array_equal(seen, part(name))
    for posed in POSE_MODELS:
        seen = standoff.simulate(part(name), homography=np.eye(3), psf=psf, model=posed).image
        np.testing.assert_allclose(seen, part(name), atol=1e-3)  # of 255, in single precision


def test_a_copy_that_says_no_encoding_is_taken_as_the_other_one(tmp_path: Path) -> None:
    deep = Image.fromarray(np.rint(part("camera") * 257).astype(np.uint16))
    deep.save(tmp_path / "deep.tif")
    before = written(tmp_path / "before.png", part("camera"))
    summary = found(before, tmp_path / "deep.tif")
    assert summary.changes == ()
    (said,) = summary.warnings
    assert "deep.tif does not state how its levels are encoded" in said
    assert "read as srgb, like that file" in said


def test_another_photograph_that_says_no_encoding_stays_what_is_usual(tmp_path: Path) -> None:
    light = part("camera") / 255
    coded = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    before = written(tmp_path / "before.png", 255 * coded)
    linear = Image.fromarray(np.rint(65535 * light).astype(np.uint16))
    linear.save(tmp_path / "linear.tif")
    summary = found(before, tmp_path / "linear.tif")
    assert summary.warnings == ()
    assert summary.changes == ()


@pytest.mark.slow
def test_the_same_scene_twice_flags_no_more_than_stated(tmp_path: Path) -> None:
    rng = np.random.default_rng(61)
    flagged, entries, frames = 0, 0, 12
    for number in range(frames):
        scene = 20 + 0.8 * part(PICTURES[number % len(PICTURES)])
        noise_dn = (1.0, 3.0, 8.0)[number % 3]
        paths = [
            written(tmp_path / f"{number}-{side}.png", scene + rng.normal(0, noise_dn, scene.shape))
            for side in "ab"
        ]
        summary = found(*paths)
        flagged += summary.changed_px
        entries += len(summary.changes) + len(summary.moved)
    # .6 pixels are stated of 12 frames; chance flags them in entries of 4 or so: more than 2
    # entries in less than one of 1,000.
    assert entries <= 2
    assert flagged <= 20


@pytest.mark.slow(minutes=0.3)
def test_noise_that_is_even_in_the_stored_levels_is_none_in_the_dark(tmp_path: Path) -> None:
    """Where light is darkest a stored level is finest: of sRGB by 30 times.

    Before the steps of the files were a term of the variance, fifteen such pairs had 20 entries.
    """
    rng = np.random.default_rng(62)
    entries = 0
    for name, corner in (("coffee", (0, 0)), ("chelsea", (0, 0)), ("astronaut", (100, 90))):
        whole = np.asarray(Image.open(Path(data.__file__).parent / f"{name}.png").convert("RGB"))
        scene = whole[corner[0] :, corner[1] :][:280, :380].astype(np.float64)
        assert np.mean(scene.max(axis=2) < 24) > 0.002
        for number in range(2):
            paths = [
                written(
                    tmp_path / f"{name}-{number}-{side}.png", scene + rng.normal(0, 2, scene.shape)
                )
                for side in "ab"
            ]
            entries += len(found(*paths).changes)
    assert entries <= 2  # more in less than one of 1,000, as above


@pytest.mark.slow(minutes=0.2)
def test_a_png_is_coded_like_the_jpeg_of_another_exposure(tmp_path: Path) -> None:
    """Coded alone, the later photograph was "sharper", and its colours had changed in 43 places."""
    rng = np.random.default_rng(63)
    entries = 0
    for name in ("coffee", "astronaut"):
        whole = np.asarray(Image.open(Path(data.__file__).parent / f"{name}.png").convert("RGB"))
        scene = whole[-280:, -380:].astype(np.float64)
        before, after = (scene + rng.normal(0, 2.5, scene.shape) for _ in range(2))
        summary = found(
            written(tmp_path / "before.png", before), written(tmp_path / "after.jpg", after, 95)
        )
        entries += len(summary.changes)
        assert abs(summary.extra_blur_px2) < 3.5 * summary.extra_blur_err_px2
    assert entries <= 3


@pytest.mark.slow
@pytest.mark.parametrize(("name", "corner"), [("ihc", (0, 26)), ("motorcycle_left", (49, 55))])
def test_two_colour_jpegs_of_one_scene_differ_in_nothing(
    tmp_path: Path, name: str, corner: tuple[int, int]
) -> None:
    """Red glass and stained cells: the chroma's tables show in the luma's light, and in red."""
    rng = np.random.default_rng(13)
    scene = np.asarray(Image.open(Path(data.__file__).parent / f"{name}.png").convert("RGB"))
    scene = scene[corner[0] : corner[0] + 320, corner[1] : corner[1] + 400].astype(np.float64)
    paths = [
        written(tmp_path / f"{side}.jpg", scene + rng.normal(0, noise_dn, scene.shape), quality)
        for side, noise_dn, quality in (("before", 2.9, 85), ("after", 2.1, 89))
    ]
    summary = found(*paths)
    assert (summary.changes, summary.moved) == ((), ())


@pytest.mark.slow(minutes=0.3)
def test_two_noisy_jpegs_in_strong_colours_differ_in_nothing(tmp_path: Path) -> None:
    """Steps of the chroma show where a colour is strong, seldom, and then much at once.

    Nine of these twelve pairs had entries when the scatter of most of the frame was taken for that
    of all of it.
    """
    rng = np.random.default_rng(64)
    with_entries = 0
    for name in ("coffee.png", "astronaut.png", "motorcycle_left.png", "retina.jpg"):
        whole = np.asarray(Image.open(Path(data.__file__).parent / name).convert("RGB"))
        scene = whole[:430, :520].astype(np.float64)
        for number in range(3):
            paths = [
                written(
                    tmp_path / f"{name}-{number}-{side}.jpg",
                    scene + rng.normal(0, rng.uniform(1, 3), scene.shape),
                    int(rng.integers(85, 99)),
                )
                for side in "ab"
            ]
            with_entries += bool(found(*paths).changes)
    # 5 % of pairs are stated to have any: more than 4 of 12 in less than one of 1,000.
    assert with_entries <= 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coffee", "astronaut"])
def test_in_noisy_jpegs_a_disc_of_another_colour_is_found(tmp_path: Path, name: str) -> None:
    """The same files with something there: a floor that hid all of it would pass above."""
    rng = np.random.default_rng(65)
    scene = np.asarray(Image.open(Path(data.__file__).parent / f"{name}.png").convert("RGB"))
    scene = scene[-280:, -380:].astype(np.float64)
    y, x = np.indices(scene.shape[:2])
    changed = scene.copy()
    changed[np.hypot(y - 150, x - 200) < 8] += (40.0, -12.0, -24.0)
    paths = [
        written(tmp_path / f"{side}.jpg", image + rng.normal(0, 2, scene.shape), 90)
        for side, image in (("before", scene), ("after", changed))
    ]
    (change,) = found(*paths).changes
    assert np.hypot(change.x_px - 200, change.y_px - 150) < 3
