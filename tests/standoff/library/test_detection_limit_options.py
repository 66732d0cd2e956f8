"""Which spots a detection limit is for, and how large a pixel is in mm."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from analysis.detection_limits import DetectionLimit, SpotLimit, percent_text, spot_sentence
from calibration.geometry import GeometryCalibration
from simulation.arrays import FloatArray
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.limit_options import limit_rgb

FRAME = (150, 190)
NOISE_DN = 1.0


def photographs(seed: int, *, gain: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """A texture twice, from one place."""
    rng = np.random.default_rng(seed)
    freq = np.hypot(np.fft.fftfreq(FRAME[0])[:, None], np.fft.rfftfreq(FRAME[1])[None])
    shape = np.exp(-((freq / 0.12) ** 2))
    scene = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(FRAME)) * shape, s=FRAME)
    scene = 100 + 20 * scene / scene.std()
    before, after = (light * scene + NOISE_DN * rng.standard_normal(FRAME) for light in (1.0, gain))
    return before, after


def geometry(**others: object) -> GeometryCalibration:
    return GeometryCalibration.model_validate(
        {
            "heights_mm": (200.0, 300.0),
            "scale_px_per_mm": (10.0, 6.875),
            "pupil_offset_mm": 20.0,
            "k1": None,
            "k2": None,
            "tilt_deg": None,
            "axis_drift_px_per_mm": None,
            **others,
        }
    )


def limit_of(options: standoff.DetectionLimitOptions) -> DetectionLimit:
    found = standoff.find_changes(*photographs(3), limit=options).summary.detection_limit
    assert found is not None
    return found


def test_sizes_in_mm_are_those_of_the_pixel_that_is_stated() -> None:
    limit = limit_of(standoff.DetectionLimitOptions(spot_sigma_px=2.0, pixel_size_mm=0.25))
    assert (limit.pixel_size_mm, limit.pixel_size_on) == (0.25, "scene")
    assert [spot.spot_sigma_px for spot in limit.spots] == [1.0, 1.5, 2.0, 3.0, 6.0]
    assert [spot.spot_sigma_mm for spot in limit.spots] == [0.25, 0.375, 0.5, 0.75, 1.5]
    assert spot_sentence(limit).startswith("a spot of 2 px (0.5 mm) and ")


@pytest.mark.parametrize(("height_mm", "size_mm"), [(None, 0.1), (200.0, 0.1), (255.0, 0.125)])
def test_a_geometry_gives_the_size_at_the_height_of_the_reference(
    height_mm: float | None, size_mm: float
) -> None:
    # 10 px/mm at 200 mm, 220 from the pupil: 8 px/mm at 255 mm, 275 from it; the zoom is 1.
    options = standoff.DetectionLimitOptions(geometry=geometry(), reference_height_mm=height_mm)
    found = standoff.find_changes(*photographs(3), limit=options)
    limit = found.summary.detection_limit
    assert limit is not None
    assert limit.pixel_size_mm == pytest.approx(size_mm, rel=1e-3)
    said = [note for note in found.notes if "lowest height" in note]
    assert bool(said) == (height_mm is None)


def test_a_height_without_a_scale_is_refused_with_those_that_have_one() -> None:
    options = standoff.DetectionLimitOptions(geometry=geometry(), reference_height_mm=900.0)
    with pytest.raises(ApplicationError, match=r"no scale at 900 mm.*between 200 and 300 mm"):
        standoff.find_changes(*photographs(3), limit=options)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"spot_sigma_px": 0.0}, "spot_sigma_px"),
        ({"contrast_dn": float("nan")}, "contrast_dn"),
        ({"pixel_size_mm": -1.0}, "pixel_size_mm"),
        ({"pixel_size_mm": 1.0, "geometry": "geometry.json"}, "give one"),
        ({"reference_height_mm": 200.0}, "needs a geometry"),
    ],
)
def test_what_contradicts_itself_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(standoff.ArgumentError, match=said):
        standoff.DetectionLimitOptions(**wrong)  # type: ignore[arg-type]


def test_the_map_the_document_and_the_share_agree(tmp_path: Path) -> None:
    options = standoff.DetectionLimitOptions(spot_sigma_px=2.5, contrast_dn=3.0)
    found = standoff.find_changes(*photographs(5), limit=options)
    found.write(tmp_path / "out")
    mapped = tifffile.imread(tmp_path / "out" / "limit.tif")
    stored = json.loads((tmp_path / "out" / "changes.json").read_text())["detection_limit"]
    assert stored["power"] == 0.95
    (spot,) = [one for one in stored["spots"] if one["spot_sigma_px"] == 2.5]
    compared = np.isfinite(mapped)
    np.testing.assert_array_equal(compared, found.valid)
    assert spot["median_dn"] == pytest.approx(float(np.median(mapped[compared])), rel=1e-3)
    assert spot["worst_dn"] == pytest.approx(float(mapped[compared].max()), rel=1e-2)
    assert spot["reached_fraction"] == pytest.approx(
        float(np.mean(mapped[compared] <= 3.0)), abs=1e-3
    )


def test_a_pose_that_is_judged_states_what_would_be_found(tmp_path: Path) -> None:
    task = standoff.DetectionTask(
        zooms=(1.0, 1.2), noises_dn=(NOISE_DN,), models=("matched",), observers=("npw",)
    )
    before, after = photographs(7)
    curves = standoff.d_prime_curves([before], standoff.GaussianPsf(0.8, 0.8), task)
    judged = standoff.judge_pose(before, after, curves, 1.0)
    compared = standoff.find_changes(before, after).summary.detection_limit
    assert judged.summary.detection_limit is not None
    assert compared is not None
    own = judged.summary.detection_limit.mapped.median_dn
    assert own == pytest.approx(compared.mapped.median_dn, rel=0.02)


def test_shares_are_never_said_to_be_all_or_none_where_they_are_not() -> None:
    assert [percent_text(share) for share in (0.0004, 0.004, 0.5, 0.994, 0.9996)] == [
        "less than 0.1 %",
        "0.4 %",
        "50 %",
        "99.4 %",
        "more than 99.9 %",
    ]


def test_the_sentence_names_size_amplitude_power_and_share() -> None:
    spot = SpotLimit(
        spot_sigma_px=1.5, median_dn=3.0, p95_dn=4.1, worst_dn=9.0, reached_fraction=0.97
    )
    limit = DetectionLimit(power=0.95, spots=(spot,), contrast_dn=5.0, map_spot_sigma_px=1.5)
    assert spot_sentence(limit) == (
        "a spot of 1.5 px and 4.1 DN would have been found (95 %) in 95 % of the compared area, "
        "and one of 5 DN in 97 % of it"
    )


@pytest.mark.parametrize("colour", ["", "purple", "1,2", "0,0,0", "1,nan,0", "1,inf,0", "1,2,3,4"])
def test_a_colour_that_is_no_direction_is_refused(colour: str) -> None:
    with pytest.raises(ArgumentError, match="colour: expected grey, red, green, blue or three"):
        standoff.DetectionLimitOptions(colour=colour)


def test_a_direction_of_colour_counts_by_its_largest_part() -> None:
    assert limit_rgb("2,-4,1") == (0.5, -1.0, 0.25)
    assert limit_rgb("blue") == (0.0, 0.0, 1.0)
