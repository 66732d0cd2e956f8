"""What a comparison of two photographs would have found: documents, and sentences on them."""

from typing import Literal

from analysis.results_file import StoredValues


class SpotLimit(StoredValues):
    """Amplitude at which Gaussian spots of one width are found, over the compared pixels.

    Parameters
    ----------
    spot_sigma_px, spot_sigma_mm
        Width of the spot as the follow-up shows it, in its pixels and, if their size is known, mm.
    median_dn, p95_dn, worst_dn
        Limit in the follow-up's levels: at half of the pixels it is lower than the first, at 95 %
        lower than the second, and nowhere higher than the third.
    reached_fraction
        Share of the compared pixels where the limit is below a contrast that was asked about.
    """

    spot_sigma_px: float
    median_dn: float
    p95_dn: float
    worst_dn: float
    reached_fraction: float | None = None
    spot_sigma_mm: float | None = None


class PredictedLimit(StoredValues):
    """A limit that was predicted, and the one that a pair shows of the same change of the scene.

    Parameters
    ----------
    spot_sigma_px
        Width with which a follow-up as sharp as predicted shows the change, in its pixels.
    noise_dn
        Standard deviation of the noise that was assumed in either photograph.
    median_dn, shown_dn, ratio
        The limit at the median place as it was predicted and as the pair shows it, in levels of a
        follow-up as sharp and as bright as predicted; the second over the first.
    factors
        By what focus, light, registration and texture each raised the limit.
    lost_to
        Sentences on those that explain a loss of more than 15 %, the most first.
    """

    spot_sigma_px: float
    noise_dn: float
    median_dn: float
    shown_dn: float
    ratio: float
    factors: dict[str, float]
    lost_to: tuple[str, ...] = ()


PixelPlane = Literal["scene", "sensor"]
"""Where the size of a pixel is measured."""


class DetectionLimit(StoredValues):
    """What a comparison would have found.

    Parameters
    ----------
    power
        Share of the spots at the limit that are found.
    spots
        Limits, a width each.
    contrast_dn
        Amplitude that was asked about.
    map_spot_sigma_px
        Width of the spots whose limit limit.tif maps.
    change_rgb
        Change of red, green and blue that the limits are for, of amplitude 1; None of photographs
        compared in grey.
    pixel_size_mm, pixel_size_on
        Side of a follow-up pixel, if it is known, and where: on the scene or on the sensor.
    predicted
        The limit that was predicted, if it was and for this zoom.
    full_scale_dn
        Level at which the follow-up is clipped, if it is known: no change is larger.
    """

    power: float
    spots: tuple[SpotLimit, ...]
    contrast_dn: float | None = None
    map_spot_sigma_px: float
    change_rgb: tuple[float, float, float] | None = None
    pixel_size_mm: float | None = None
    pixel_size_on: PixelPlane | None = None
    predicted: PredictedLimit | None = None
    full_scale_dn: float | None = None

    @property
    def mapped(self) -> SpotLimit:
        """The limit that limit.tif maps."""
        return next(spot for spot in self.spots if spot.spot_sigma_px == self.map_spot_sigma_px)


AGREEING_RATIO = 1.15
"""Ratio of shown and predicted limits up to which they agree."""

_WHERE = {"scene": "", "sensor": " on the sensor"}


def spot_sentence(limit: DetectionLimit) -> str:
    """Say which spots of the mapped width would have been found, and where one asked about."""
    spot, most_dn = limit.mapped, limit.full_scale_dn
    size, found = size_text(spot, limit), f"would have been found ({100 * limit.power:.0f} %)"
    change = _of_change(limit)
    if most_dn is None or spot.p95_dn <= most_dn:
        sentence = (
            f"a spot of {size} and {level_text(spot.p95_dn)} DN {change}{found} in 95 % of the "
            "compared area"
        )
    elif spot.median_dn <= most_dn:
        sentence = (
            f"a spot of {size} and {level_text(spot.median_dn)} DN {change}{found} in half of the "
            f"compared area, and in more than 5 % of it none, however strong: levels end at "
            f"{most_dn:g} DN"
        )
    else:
        sentence = (
            f"in more than half of the compared area no spot of {size} {change}{found}, however "
            f"strong: levels end at {most_dn:g} DN"
        )
    if limit.contrast_dn is not None and spot.reached_fraction is not None:
        sentence += (
            f", and one of {limit.contrast_dn:g} DN in {percent_text(spot.reached_fraction)} of it"
        )
    return sentence


def _of_change(limit: DetectionLimit) -> str:
    """Of which change of colour, where that is none of grey."""
    rgb = limit.change_rgb
    if rgb is None or rgb == (1.0, 1.0, 1.0):
        return ""
    return f"({', '.join(f'{part:.3g}' for part in rgb)} in red, green, blue) "


def prediction_sentence(predicted: PredictedLimit) -> str:
    """Say how the limit that a pair shows and the predicted one compare, and why."""
    said = (
        f"for a change that shows as a spot of {predicted.spot_sigma_px:.2g} px, the pair shows a "
        f"limit of {level_text(predicted.shown_dn)} DN where "
        f"{level_text(predicted.median_dn)} DN were predicted"
    )
    if predicted.lost_to:
        return f"{said}: {'; '.join(predicted.lost_to)}"
    if predicted.ratio > AGREEING_RATIO:
        return f"{said}; nothing in the pair shows why"
    return said


def size_text(spot: SpotLimit, limit: DetectionLimit) -> str:
    """Return the width of a spot as people read it."""
    text = f"{spot.spot_sigma_px:g} px"
    if spot.spot_sigma_mm is None:
        return text
    return f"{text} ({spot.spot_sigma_mm:.2g} mm{_WHERE[limit.pixel_size_on or 'scene']})"


def level_text(level_dn: float) -> str:
    """Two digits of a level, without an exponent."""
    return f"{float(f'{level_dn:.2g}'):g}"


def percent_text(share: float) -> str:
    """Return a share in per cent: of nearly all or nearly none, never all or none."""
    if 0 < share < 0.001:
        return "less than 0.1 %"
    if 0.999 < share < 1:
        return "more than 99.9 %"
    if share < 0.01 or share > 0.99:
        return f"{100 * share:.1f} %"
    return f"{100 * share:.0f} %"
