"""Pairs in which nothing changed, and pairs with things, are what they say."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from benchmarks.peers.listers import aligned_difference, plain_difference, ssim_contours_otsu
from benchmarks.truth.pictures import (
    KINDS,
    MOST_PX,
    NullPair,
    Picture,
    catalogue,
    null_pairs,
    smaller,
    with_noise,
)
from benchmarks.truth.things import (
    REACH_PX,
    VISIBLE_DN,
    length_of,
    shift_in_followup,
    suitable,
    thing_pair,
)

CAMERA = "skimage/camera"
COFFEE = "skimage/coffee"


@pytest.fixture(scope="module")
def pictures() -> dict[str, Picture]:
    return {one.name: one for one in catalogue().pictures}


def stored(path: Path) -> NDArray[np.float64]:
    with Image.open(path) as image:
        return np.asarray(image, dtype=np.float64)


def test_a_development_environment_has_pictures_of_all_sorts() -> None:
    found = catalogue().pictures
    assert len(found) >= 40
    assert {one.genre for one in found} >= {
        "photograph", "drawing", "text", "texture", "stars", "microscopy", "flat"
    }  # fmt: skip
    assert len({one.name for one in found}) == len(found)


def test_every_picture_is_levels_in_grey_or_colour() -> None:
    for picture in catalogue().pictures:
        levels = picture.levels()
        assert levels.dtype == np.uint8, picture.name
        assert levels.ndim == 2 or levels.shape[2] == 3, picture.name
        assert min(levels.shape[:2]) >= 96, picture.name
        if levels.ndim == 3:
            assert np.any(levels != levels[..., :1]), picture.name


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_makes_the_same_pair_and_another_number_another(
    kind: str, pictures: dict[str, Picture], tmp_path: Path
) -> None:
    made = []
    for turn, number in enumerate((3, 3, 4)):
        folder = tmp_path / str(turn)
        folder.mkdir()
        pair = NullPair(number=number, seed=7, kind=kind, picture=pictures[COFFEE])
        files = pair.make(folder)
        made.append((files.before.read_bytes(), files.after.read_bytes()))
    assert made[0] == made[1]
    assert made[0] != made[2]


def test_a_file_and_itself_are_equal_bytes(pictures: dict[str, Picture], tmp_path: Path) -> None:
    for number in range(6):
        pair = NullPair(number=number, seed=1, kind="itself", picture=pictures[CAMERA])
        files = pair.make(tmp_path)
        assert files.before != files.after
        assert files.before.read_bytes() == files.after.read_bytes()


def test_png_and_tiff_hold_the_same_levels(pictures: dict[str, Picture], tmp_path: Path) -> None:
    pair = NullPair(number=2, seed=1, kind="png-tiff8", picture=pictures[COFFEE])
    files = pair.make(tmp_path)
    assert np.array_equal(stored(files.before), stored(files.after))


def test_a_part_of_the_frame_is_found_in_it(pictures: dict[str, Picture], tmp_path: Path) -> None:
    pair = NullPair(number=5, seed=1, kind="crop", picture=pictures[CAMERA])
    files = pair.make(tmp_path)
    whole, part = sorted((stored(files.before), stored(files.after)), key=np.size, reverse=True)
    rows, cols = part.shape
    places = [
        (top, left)
        for top in range(whole.shape[0] - rows + 1)
        for left in range(whole.shape[1] - cols + 1)
        if whole[top, left] == part[0, 0]
        and np.array_equal(whole[top : top + rows, left : left + cols], part)
    ]
    assert len(places) == 1


@pytest.mark.parametrize("snr", [5.0, 40.0, 1000.0])
def test_white_noise_has_the_deviation_that_was_asked_for(snr: float) -> None:
    levels = np.linspace(60, 180, 40_000).reshape(200, 200)
    noisy = with_noise(levels, snr, np.random.default_rng(1), is_shot=False, is_srgb=False)
    # 40,000 px: .35 %, four standard errors.
    assert (noisy - levels).std() == pytest.approx(levels.mean() / snr, rel=0.015)
    assert not np.shares_memory(noisy, levels)


def test_shot_noise_grows_with_the_root_of_the_light() -> None:
    levels = np.repeat([[60.0, 120.0, 240.0]], 40_000, axis=0)
    noisy = with_noise(levels, 20.0, np.random.default_rng(1), is_shot=True, is_srgb=False)
    # Mean light 140: 140 / 20 there, and its root elsewhere.
    expected = 7.0 * np.sqrt(levels[0] / 140)
    assert noisy.std(axis=0) == pytest.approx(expected, rel=0.015)
    assert noisy.mean(axis=0) == pytest.approx(levels[0], rel=0.002)


def test_shot_noise_of_an_srgb_picture_is_poisson_in_light() -> None:
    levels = np.full((300, 300), 188.0)
    noisy = with_noise(levels, 30.0, np.random.default_rng(1), is_shot=True, is_srgb=True)
    share = (noisy / 255 + 0.055) / 1.055
    light = share**2.4
    # 188 is half the light of white by IEC 61966-2-1, to .5 %; 90,000 px.
    assert light.mean() == pytest.approx(0.5, rel=0.01)
    assert light.std() == pytest.approx(light.mean() / 30, rel=0.02)


def test_stored_noise_differs_between_the_two_and_is_as_large_in_both(
    pictures: dict[str, Picture], tmp_path: Path
) -> None:
    pair = NullPair(number=11, seed=1, kind="white-16", picture=pictures[CAMERA])
    files = pair.make(tmp_path)
    before, after = stored(files.before), stored(files.after)
    assert before.max() > 255
    snr = float(files.recipe.split("SNR ")[1].split(",")[0])
    middle = (before > 3000) & (before < 60000)  # away from both ends, where noise is clipped
    difference = (after - before)[middle]
    expected = np.sqrt(2) * before.mean() / snr
    # What is near the ends of the scale and left out takes a little of it.
    assert difference.std() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("way", ["area", "lanczos", "bicubic", "hamming", "spline"])
def test_a_smaller_picture_shows_a_slope_where_it_lies(way: str) -> None:
    zoom = 0.77
    y, x = np.mgrid[:150, :200].astype(np.float64)
    made = smaller(50 + 0.5 * x + 0.25 * y, zoom, way)
    rows, cols = made.shape
    assert (rows, cols) == (115, 154)
    v, u = ((np.arange(n) + 0.5) / zoom - 0.5 for n in (rows, cols))
    expected = 50 + 0.5 * u + 0.25 * v[:, None]
    # .2: Pillow rounds its kernels to pixels; a tenth of a pixel is .05 here.
    assert np.abs(made - expected)[8:-8, 8:-8].max() < 0.2


def test_all_pictures_come_once_before_any_comes_again() -> None:
    shelf = catalogue().pictures
    pairs = list(null_pairs(shelf, KINDS, 2 * len(shelf), 5))
    for turn in (pairs[: len(shelf)], pairs[len(shelf) :]):
        assert {pair.picture.name for pair in turn} == {one.name for one in shelf}
    assert [pair.kind for pair in pairs[: len(KINDS)]] == list(KINDS)


def test_regions_are_no_larger_than_stated(pictures: dict[str, Picture], tmp_path: Path) -> None:
    pair = NullPair(number=1, seed=1, kind="png-jpeg", picture=pictures["skimage/retina"])
    files = pair.make(tmp_path)
    assert stored(files.before).shape[:2] == MOST_PX
    assert stored(files.after).shape[:2] == MOST_PX


@pytest.mark.slow
def test_things_are_where_they_are_said_to_be(tmp_path: Path) -> None:
    photographs = suitable(catalogue().pictures)
    for number in range(3):  # one pose, on each ground
        pair = thing_pair(photographs, number, 3, tmp_path)
        before, after = (stored(path) for path in (pair.before, pair.after))
        off = np.abs(after - before).mean(axis=2)
        distance = np.min([thing.distance_px for thing in pair.things], axis=0)
        for thing in pair.things:
            assert thing.contrast_dn >= VISIBLE_DN
            assert off[thing.outlines].mean() > 2 * off[distance > 16].mean()
        # Elsewhere noise of 1 to 3 DN twice and two JPEGs.
        assert off[distance > 16].mean() < 6


@pytest.mark.slow
def test_the_same_seed_makes_the_same_things(tmp_path: Path) -> None:
    photographs = suitable(catalogue().pictures)
    made = []
    for turn in ("a", "b"):
        folder = tmp_path / turn
        folder.mkdir()
        pair = thing_pair(photographs, 4, 3, folder)
        made.append((pair.before.read_bytes(), pair.after.read_bytes()))
    assert made[0] == made[1]


@pytest.mark.slow
def test_an_entry_belongs_to_a_thing_up_to_its_reach(tmp_path: Path) -> None:
    pair = thing_pair(suitable(catalogue().pictures), 0, 3, tmp_path)
    for thing in pair.things:
        rows, cols = np.nonzero(thing.outlines)
        assert thing.holds(float(cols[0]), float(rows[0]))
        top = int(rows.argmin())
        reach = max(REACH_PX, 0.3 * thing.size_px)
        assert not thing.holds(float(cols[top]), float(rows[top]) - reach - 1.5)


def test_a_shift_from_one_pose_is_that_of_the_reference(tmp_path: Path) -> None:
    pair = thing_pair(suitable(catalogue().pictures), 0, 3, tmp_path)
    moved = [thing for thing in pair.things if thing.happening == "moved"]
    assert moved
    for thing in moved:
        assert shift_in_followup(pair, thing) == pytest.approx(thing.shift_px, abs=1e-9)
        assert 1.5 < length_of(thing.shift_px) < 21


def test_peers_list_a_square_and_nothing_of_a_copy(
    pictures: dict[str, Picture], tmp_path: Path
) -> None:
    levels = pictures[COFFEE].levels()[:300, :400]
    Image.fromarray(levels).save(tmp_path / "before.png")
    Image.fromarray(levels).save(tmp_path / "same.png")
    changed = levels.copy()
    changed[100:130, 200:240] = 255 - changed[100:130, 200:240]
    Image.fromarray(changed).save(tmp_path / "after.png")
    for lister in (plain_difference, aligned_difference):
        assert lister(tmp_path / "before.png", tmp_path / "same.png") == ()
    for lister in (plain_difference, aligned_difference, ssim_contours_otsu):
        entries = lister(tmp_path / "before.png", tmp_path / "after.png")
        assert any(195 < one.x_px < 245 and 95 < one.y_px < 135 for one in entries)


def test_kinds_have_names_of_their_own() -> None:
    assert all(one != other for one, other in pairwise(sorted(KINDS)))
