from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation import (
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    Psf,
    PsfField,
    SamplingGrid,
    zoom_out_on_grid,
)
from simulation.choices import MODELS, Model
from simulation.zoom import crop_origins, sr_pairs, zoom_operator

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=0.1)
TURNED_LENS = MeasuredPsf(
    lens=LensOtf(cut_off_period_px=(0.35, 0.1, 0.5), defocus_waves2=(0.09, 0.0, 0.09)),
    gaussian=GaussianPsf(sigma_x_px=0.55, sigma_y_px=0.6),
)


@given(size=st.integers(1, 400), crop=st.integers(1, 400), stride=st.integers(1, 200))
def test_crops_lie_inside_and_reach_both_borders(size: int, crop: int, stride: int) -> None:
    if crop > size:
        with pytest.raises(ValueError):
            crop_origins(size, crop, stride)
        return
    origins = crop_origins(size, crop, stride)
    assert origins[0] == 0
    assert origins[-1] + crop == size
    assert origins == sorted(set(origins))
    assert all(b - a <= stride for a, b in pairwise(origins))


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("zoom", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("psf", [PSF, TURNED_LENS])
def test_a_crop_equals_that_part_of_the_whole_image_seen_from_further_away(
    model: Model, zoom: float, psf: Psf
) -> None:
    image = np.random.default_rng(8).uniform(0.0, 255.0, (260, 330))
    pairs = list(sr_pairs(image, zoom, psf, crop_px=60, stride_px=110, model=model))
    assert len(pairs) == 3 * 4
    for pair in (pairs[0], pairs[5], pairs[-1]):
        n = pair.low.shape[0]
        assert n == 60 / zoom
        centre_y, centre_x = pair.top_px + 29.5, pair.left_px + 29.5
        grid = SamplingGrid(
            zoom_y=zoom,
            zoom_x=zoom,
            origin_y_px=centre_y - (n - 1) / 2 * zoom,
            origin_x_px=centre_x - (n - 1) / 2 * zoom,
            rows=n,
            cols=n,
        )
        whole = zoom_out_on_grid(image, grid, psf, model)
        # White noise of 255 DN; tails of a lens reach beyond any margin.
        atol = 0.02 if psf is PSF else 0.05
        np.testing.assert_allclose(pair.low, whole, atol=atol)
        np.testing.assert_array_equal(
            pair.high, image[pair.top_px : pair.top_px + 60, pair.left_px : pair.left_px + 60]
        )


def test_a_blob_stands_at_the_same_place_in_both() -> None:
    y, x = np.mgrid[:120, :150].astype(np.float64)
    blob = np.exp(-((x - 83.0) ** 2 + (y - 52.0) ** 2) / (2 * 4.0**2))
    (pair,) = (
        p
        for p in sr_pairs(blob, 2.0, PSF, crop_px=64, stride_px=28)
        if (p.top_px, p.left_px) == (28, 56)
    )
    low = np.asarray(pair.low, dtype=np.float64)
    rows, cols = np.mgrid[:32, :32]
    centre = (float((rows * low).sum() / low.sum()), float((cols * low).sum() / low.sum()))
    # By the grid's definition: (place - 31.5) / 2 + 15.5.
    assert centre[0] == pytest.approx((52.0 - 28 - 31.5) / 2 + 15.5, abs=0.01)
    assert centre[1] == pytest.approx((83.0 - 56 - 31.5) / 2 + 15.5, abs=0.01)


def test_colour_and_dtype_are_kept() -> None:
    image = np.random.default_rng(1).integers(0, 255, (90, 90, 3)).astype(np.uint8)
    pair = next(sr_pairs(image, 2.0, PSF, crop_px=40, stride_px=40))
    assert pair.high.dtype == np.uint8
    assert pair.low.shape == (20, 20, 3)


# 0.5 px^2 in the middle of the frame, three times that at its corners.
FIELD = PsfField(
    width_px=330,
    height_px=260,
    coefficients_px2=np.array([[0.5, 0, 0, 1, 0, 1], [0] * 6, [0.5, 0, 0, 1, 0, 1]]),
)


def test_a_crop_of_a_frame_gets_the_psf_of_its_part_of_the_frame() -> None:
    image = np.random.default_rng(8).uniform(0.0, 255.0, (260, 330))
    of_field, of_middle = (
        list(sr_pairs(image, 2.0, psf, crop_px=60, stride_px=100))
        for psf in (FIELD, FIELD.at(*FIELD.centre_px))
    )
    corner, middle = of_field[0], of_field[5]
    assert (middle.top_px, middle.left_px) == (100, 100)
    # The parts are 66 px wide and 52 px high: the corner's crop lies in the first.
    own = FIELD.at(32.5, 25.5)
    assert own.covariance_px2[0, 0] > 1.1
    (expected, *_) = sr_pairs(image, 2.0, own, crop_px=60, stride_px=100)
    np.testing.assert_array_equal(corner.low, expected.low)
    assert np.abs(corner.low - of_middle[0].low).max() > 5.0


def test_a_field_of_another_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="330 x 260"):
        list(sr_pairs(np.ones((330, 260)), 2.0, FIELD, crop_px=60, stride_px=60))


@pytest.mark.parametrize(("crop", "zoom"), [(100, 2.0), (2, 3.0)])
def test_crops_larger_than_the_image_or_smaller_than_a_pixel_are_refused(
    crop: int, zoom: float
) -> None:
    with pytest.raises(ValueError):
        list(sr_pairs(np.ones((50, 50)), zoom, PSF, crop_px=crop, stride_px=10))


@pytest.mark.parametrize(("crop", "stride"), [(0, 10), (10, 0), (-5, 10), (10, -1)])
def test_crops_without_size_or_step_are_refused(crop: int, stride: int) -> None:
    with pytest.raises(ValueError):
        crop_origins(100, crop, stride)


def test_the_next_frame_with_a_field_solves_no_kernel_anew() -> None:
    field = PsfField(
        width_px=330,
        height_px=260,
        # Not symmetric: 25 positions have 25 PSFs.
        coefficients_px2=np.array(
            [
                [0.6, 0.05, 0.03, 0.3, 0, 0.3],
                [0, 0.01, 0, 0, 0.02, 0],
                [0.6, 0.02, 0.07, 0.3, 0, 0.3],
            ]
        ),
    )
    frame = np.random.default_rng(5).uniform(0, 255, (260, 330))

    def operators_made() -> int:
        for _ in sr_pairs(frame, 1.5, field, crop_px=60, stride_px=30, model="matched"):
            pass
        return zoom_operator.cache_info().misses

    assert operators_made() == operators_made()
