"""A limit in words: an amplitude that the file cannot hold is none."""

import pytest

from analysis.detection_limits import DetectionLimit, SpotLimit, spot_sentence


def limit(median_dn: float, p95_dn: float, full_scale_dn: float | None) -> DetectionLimit:
    spot = SpotLimit(
        spot_sigma_px=1.5,
        median_dn=median_dn,
        p95_dn=p95_dn,
        worst_dn=2 * p95_dn,
        reached_fraction=None,
    )
    return DetectionLimit(
        power=0.95, spots=(spot,), map_spot_sigma_px=1.5, full_scale_dn=full_scale_dn
    )


@pytest.mark.parametrize(
    ("median_dn", "p95_dn", "full_scale_dn", "sentence"),
    [
        (
            40.0,
            160.0,
            255.0,
            "a spot of 1.5 px and 160 DN would have been found (95 %) in 95 % of the compared area",
        ),
        (
            240.0,
            900.0,
            255.0,
            "a spot of 1.5 px and 240 DN would have been found (95 %) in half of the compared "
            "area, and in more than 5 % of it none, however strong: levels end at 255 DN",
        ),
        (
            400.0,
            900.0,
            255.0,
            "in more than half of the compared area no spot of 1.5 px would have been found "
            "(95 %), however strong: levels end at 255 DN",
        ),
        (
            400.0,
            900.0,
            None,
            "a spot of 1.5 px and 900 DN would have been found (95 %) in 95 % of the compared area",
        ),
    ],
)
def test_no_amplitude_is_named_that_the_file_cannot_hold(
    median_dn: float, p95_dn: float, full_scale_dn: float | None, sentence: str
) -> None:
    assert spot_sentence(limit(median_dn, p95_dn, full_scale_dn)) == sentence
