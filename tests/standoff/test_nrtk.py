import sys
from abc import ABC
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest

import standoff
from simulation.capture_noise import CaptureNoise
from standoff.nrtk import FollowupPerturber

PSF = standoff.GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8, rho=0.0)
NOISE = CaptureNoise(gain_e_per_dn=2.0, read_noise_e=4.0, black_level_dn=0.0)


@dataclass(frozen=True)
class Box:
    min_vertex: tuple[float, float]
    max_vertex: tuple[float, float]


def test_a_flat_image_stays_flat_in_any_encoding_and_type() -> None:
    for encoding in ("srgb", "linear", "gamma:2.2"):
        perturber = FollowupPerturber(PSF, 1.5, encoding=encoding)
        for dtype, level in ((np.uint8, 90), (np.uint16, 30000), (np.float32, 0.25)):
            image = np.full((30, 45, 3), level, dtype=dtype)
            seen, boxes = perturber.perturb(image=image)
            assert seen.shape == (20, 30, 3)
            assert seen.dtype == dtype
            assert boxes is None
            np.testing.assert_allclose(seen, image[:20, :30], rtol=1e-5)


def test_light_is_averaged_and_not_levels() -> None:
    # Stripes of one pixel are far above what the follow-up resolves: it shows their mean light.
    image = np.zeros((60, 60), dtype=np.uint8)
    image[:, ::2] = 255
    seen, _ = FollowupPerturber(standoff.GaussianPsf(sigma_x_px=2, sigma_y_px=2, rho=0), 3)(image)
    assert abs(int(np.median(seen[5:-5, 5:-5])) - 188) <= 2  # half of the light is sRGB's 188


def test_boxes_stay_on_what_they_hold() -> None:
    image = np.full((40, 61), 20, dtype=np.uint8)
    image[10:20, 30:48] = 200
    boxes = [(Box((30, 10), (48, 20)), {"car": 0.9})]
    seen, moved = FollowupPerturber(PSF, 2.0, encoding="linear").perturb(image=image, boxes=boxes)
    assert moved is not None
    ((box, scores),) = moved
    # About the common centre (30.5, 20), which is (15, 10) of the follow-up's 30 x 20 px.
    assert box == Box((14.75, 5.0), (23.75, 10.0))
    assert scores == {"car": 0.9}
    assert scores is not boxes[0][1]
    light = seen.astype(float) - 20
    centre = (light * (np.arange(30) + 0.5)).sum() / light.sum()
    assert centre == pytest.approx((14.75 + 23.75) / 2, abs=0.02)  # a level of 180 is rounded
    rows = (light.sum(axis=1) * (np.arange(20) + 0.5)).sum() / light.sum()
    assert rows == pytest.approx(7.5, abs=0.02)


def test_noise_is_that_of_the_camera_and_differs_between_images_alone() -> None:
    perturber = FollowupPerturber(PSF, 1.5, NOISE, encoding="linear")
    # Shot noise of 200 electrons, read noise of 4, at 2 electrons a level.
    expected = np.sqrt((200 + 16) / 4)
    taken = np.random.default_rng(2).normal(100, expected, (300, 300)).round().astype(np.uint16)
    # Of 40,000 px the standard deviation is known to 0.35 %; rounding, at either end, adds 0.2 %.
    assert perturber(image=taken)[0].std() == pytest.approx(expected, rel=0.02)
    image = np.full((300, 300), 100, dtype=np.uint16)
    one, again = (perturber(image=image)[0] for _ in range(2))
    np.testing.assert_array_equal(one, again)
    other, _ = perturber(image=image + 1)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.03
    reseeded, _ = FollowupPerturber(PSF, 1.5, NOISE, encoding="linear", seed=1)(image=image)
    assert (reseeded != one).any()


def test_the_image_that_was_given_stays_as_it_was() -> None:
    image = np.random.default_rng(1).integers(0, 255, (30, 30)).astype(np.uint8)
    kept = image.copy()
    FollowupPerturber(PSF, 1.2)(image=image, img_gsd=0.1)
    np.testing.assert_array_equal(image, kept)


def test_its_configuration_makes_it_again() -> None:
    perturber = FollowupPerturber(PSF, 1.5, encoding="linear", seed=3)
    again = FollowupPerturber(**perturber.get_config())
    assert again.get_config() == perturber.get_config()


def test_it_is_one_of_nrtks_perturbers_where_nrtk_is_in_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class PerturbImage(ABC):  # noqa: B024 - stands for NRTK's
        pass

    interfaces = ModuleType("nrtk.interfaces")
    interfaces.PerturbImage = PerturbImage  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "nrtk.interfaces", interfaces)
    assert isinstance(FollowupPerturber(PSF, 1.5), PerturbImage)


@pytest.mark.parametrize("zoom", [0.9, float("nan"), float("inf")])
def test_a_zoom_that_is_none_is_refused(zoom: float) -> None:
    with pytest.raises(standoff.ArgumentError, match="zoom"):
        FollowupPerturber(PSF, zoom)


def test_an_encoding_that_is_none_is_refused() -> None:
    with pytest.raises(standoff.ArgumentError, match="encoding: 'log' is not an encoding"):
        FollowupPerturber(PSF, 1.5, encoding="log")
