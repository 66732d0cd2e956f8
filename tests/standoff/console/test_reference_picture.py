"""The reference as a picture: its levels as of the live picture, and its edges alone."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from standoff.console.frames import levels_8bit
from standoff.console.reference_picture import ReferencePicture, edge_mask, reference_numbers

ROWS, COLS = 90, 140


def step_dn(column_px: float, *, noise_dn: float = 8.0) -> NDArray[np.uint16]:
    """Dark up to a column, bright from there on; the edge is 1 px wide."""
    x_px = np.broadcast_to(np.arange(COLS), (ROWS, COLS))
    share = 0.5 + 0.5 * erf((x_px - column_px) / np.sqrt(2))
    noise = np.random.default_rng(3).normal(0, noise_dn, (ROWS, COLS))
    return np.asarray(np.rint(600 + 1500 * share + noise), dtype=np.uint16)


def reference(image_dn: NDArray[np.uint16] | NDArray[np.float32], most: float) -> ReferencePicture:
    return ReferencePicture(number=1, name="before", image_dn=image_dn, max_level_dn=most)


def decoded(data: bytes) -> NDArray[np.uint8]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image, np.uint8)


@pytest.mark.parametrize("column_px", [30.0, 71.25, 101.75])
def test_an_edge_is_drawn_within_a_pixel_of_where_it_is_and_nothing_else(column_px: float) -> None:
    rows, cols = np.nonzero(edge_mask(step_dn(column_px)))
    assert set(rows) >= set(range(5, ROWS - 5))
    assert np.abs(cols - column_px).max() <= 1.0


@pytest.mark.parametrize("noise_dn", [0.0, 0.2, 0.3, 0.5, 1.0, 30.0])
def test_even_paper_has_no_edges_however_noisy(noise_dn: float) -> None:
    noise = np.random.default_rng(7).normal(0, noise_dn, (600, 800))
    assert not edge_mask(np.rint(900 + noise).astype(np.uint16)).any()


def test_a_mean_whose_invalid_pixels_are_nan_is_shown() -> None:
    image = step_dn(70.0).astype(np.float32)
    image[3, 4] = np.nan
    assert decoded(reference(image, 4095).png("photo"))[3, 4] == 0
    assert edge_mask(image).any()


def test_the_photograph_has_the_levels_of_the_live_picture() -> None:
    image = step_dn(70.0)
    image[5, 6] = 4095
    shown = decoded(reference(image, 4095).png("photo"))
    np.testing.assert_array_equal(shown, levels_8bit(image, 4095))
    assert shown[5, 6] == 255
    assert len(reference(image, 4095).png("photo")) < image.size  # less than a byte a pixel


def test_the_edges_are_opaque_and_the_rest_is_transparent() -> None:
    image = step_dn(70.0)
    shown = decoded(reference(image, 4095).png("edges"))
    np.testing.assert_array_equal(shown[..., 3] == 255, edge_mask(image))
    np.testing.assert_array_equal(shown[..., 3] == 0, ~edge_mask(image))


def test_a_picture_is_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = reference(step_dn(70.0), 4095)
    first = {view: made.png(view) for view in ("photo", "edges")}
    monkeypatch.setattr("standoff.console.reference_picture.cv2", None)
    assert {view: made.png(view) for view in ("photo", "edges")} == first


def test_numbers_of_references_are_above_those_of_an_earlier_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("time.time", lambda: 1e9)
    earlier = reference_numbers()
    used = [next(earlier) for _ in range(100)]
    monkeypatch.setattr("time.time", lambda: 1e9 + 1)
    assert next(reference_numbers()) > used[-1]
    assert len(set(used)) == 100
