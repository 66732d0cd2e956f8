"""The PSF from scenes that were not made for it, on photographs known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.blind.calibration import calibrate_from_distances, calibrate_from_scene
from calibration.edges.image import EdgeImage, Region
from calibration.errors import NoEdgeError, PairError
from calibration.noise.noise_by_level import LevelNoise
from calibration.psf.document import PsfCalibration
from tests.calibration.blob_scene import blob_photograph
from tests.calibration.edge_photographs import (
    EIGHT_NORMALS_DEG,
    SIGMA_X_PX,
    SIGMA_Y_PX,
    photographs,
)

TILTED = np.array([[0.45, 0.06], [0.06, 0.33]])
"""With the pixel: optically 0.45 - 1/12 along x."""
WHOLE = (240, 320)


@pytest.fixture(scope="module")
def near() -> EdgeImage:
    return EdgeImage(name="near.tif", image_dn=blob_photograph(1.0, TILTED))


@pytest.fixture(scope="module")
def far() -> EdgeImage:
    return EdgeImage(name="far.tif", image_dn=blob_photograph(2.0, TILTED))


def widths(psf: PsfCalibration) -> tuple[float, float]:
    assert psf.sigma_x_px is not None
    assert psf.sigma_y_px is not None
    return psf.sigma_x_px, psf.sigma_y_px


def test_two_distances_give_the_whole_psf_without_the_zoom(near: EdgeImage, far: EdgeImage) -> None:
    psf = calibrate_from_distances([[near, far]])
    assert widths(psf) == pytest.approx(np.sqrt([0.45, 0.33]), rel=0.01)
    assert psf.rho == pytest.approx(0.06 / np.sqrt(0.45 * 0.33), abs=0.02)
    assert psf.optical_sigma_x_px == pytest.approx(np.sqrt(0.45 - 1 / 12), rel=0.02)
    [pair] = psf.pairs
    assert (pair.near, pair.far) == ("near.tif", "far.tif")
    assert pair.zoom == pytest.approx(2.0, abs=0.005)


def test_a_region_of_the_nearest_photograph_gives_the_same(near: EdgeImage, far: EdgeImage) -> None:
    # Off the middle, and not square: its places are counted from its own corner.
    region = Region(x_px=40, y_px=10, width_px=260, height_px=200)
    psf = calibrate_from_distances([[near, far]], zoom=2.0, region=lambda _: region)
    assert widths(psf) == pytest.approx(np.sqrt([0.45, 0.33]), rel=0.02)


def test_known_noise_of_the_nearest_photograph_is_taken_out(
    near: EdgeImage, far: EdgeImage
) -> None:
    rng = np.random.default_rng(5)
    noisy = replace(near, image_dn=near.image_dn + rng.normal(0, 20.0, WHOLE))
    known = replace(noisy, noise=LevelNoise(offset_dn2=400.0, slope_dn=0.0, floor_dn2=1.0))
    told = widths(calibrate_from_distances([[known, far]], zoom=2.0))
    untold = widths(calibrate_from_distances([[noisy, far]], zoom=2.0))
    assert told == pytest.approx(np.sqrt([0.45, 0.33]), rel=0.03)
    assert untold[0] > 1.02 * told[0]


def test_a_pair_that_cannot_be_used_is_left_out_and_counted_as_done(
    near: EdgeImage, far: EdgeImage
) -> None:
    done: list[int] = []
    again = replace(near, name="again.tif")
    psf = calibrate_from_distances([[near, again, far]], progress=done.append)
    # From the same distance nothing is to be learnt.
    assert [pair.far for pair in psf.pairs] == ["far.tif"]
    assert done == [1, 2]


def test_where_no_pair_is_left_the_first_ones_fault_is_told(near: EdgeImage) -> None:
    again = replace(near, name="again.tif")
    with pytest.raises(PairError) as refused:
        calibrate_from_distances([[near, again]])
    assert refused.value.reason == "one_distance"
    assert refused.value.photographs == ("near.tif", "again.tif")
    assert "near.tif and again.tif" in str(refused.value)
    with pytest.raises(PairError) as alone:
        calibrate_from_distances([[near]])
    assert alone.value.reason == "no_pair"


def test_the_further_photograph_first_is_refused_with_the_remedy(
    near: EdgeImage, far: EdgeImage
) -> None:
    with pytest.raises(PairError) as refused:
        calibrate_from_distances([[far, near]])
    assert refused.value.reason == "not_aligned"
    assert "give the nearer photograph first" in str(refused.value)


@pytest.mark.parametrize("spoilt", ["near.tif", "far.tif"])
def test_a_saturated_photograph_is_named_with_its_share(
    near: EdgeImage, far: EdgeImage, spoilt: str
) -> None:
    # A hundredth of the pixels at the top, and the limit there.
    pair = []
    for source in (near, far):
        image = source.image_dn.copy()
        if source.name == spoilt:
            image.ravel()[: image.size // 100] = 4095.0
        pair.append(replace(source, image_dn=image, saturation_dn=4095.0))
    with pytest.raises(PairError) as refused:
        calibrate_from_distances([pair])
    assert (refused.value.reason, refused.value.photographs) == ("saturated", (spoilt,))
    assert f"{spoilt}: 1.0 %" in str(refused.value)


def test_sharp_edges_of_a_scene_give_the_psf_to_a_tenth() -> None:
    # Each direction twice: 16 edges of one lens, none of them soft by itself.
    sources = [
        replace(source, name=f"{seed}-{source.name}")
        for seed in (1, 2)
        for source in photographs(EIGHT_NORMALS_DEG, seed=seed)
    ]
    done: list[int] = []
    psf = calibrate_from_scene(sources, progress=done.append)
    assert psf.method == "single-image"
    expected = np.sqrt(np.array([SIGMA_X_PX, SIGMA_Y_PX]) ** 2 + 1 / 12)
    assert widths(psf) == pytest.approx(expected, rel=0.1)
    assert psf.softness_px2 is not None
    assert psf.softness_px2 < 0.05
    assert done == list(range(1, 17))


def test_a_scene_of_too_few_edges_is_named_with_the_remedy() -> None:
    [one, two] = photographs([4.0, 94.0])
    with pytest.raises(NoEdgeError) as refused:
        calibrate_from_scene([one])
    assert refused.value.found == 1
    assert one.name in str(refused.value)
    with pytest.raises(NoEdgeError) as both:
        calibrate_from_scene([one, two])
    assert both.value.found == 2
