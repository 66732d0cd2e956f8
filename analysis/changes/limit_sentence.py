"""What a comparison would have found, in sentences."""

from analysis.changes.document import ChangeSummary, DetectionLimit, SpotLimit

_WHERE = {"scene": "", "sensor": " on the sensor"}


def describe_limit(found: ChangeSummary) -> str | None:
    """Say which spots would have been found; None in files of before."""
    limit = found.detection_limit
    if limit is None:
        return None
    spot = limit.mapped
    sentence = (
        f"a spot of {size_text(spot, limit)} and {spot.p95_dn:.2g} DN would have been found "
        f"({100 * limit.power:.0f} %) in 95 % of the compared area"
    )
    if limit.contrast_dn is not None and spot.reached_fraction is not None:
        sentence += (
            f", and one of {limit.contrast_dn:g} DN in {_percent(spot.reached_fraction)} of it"
        )
    if found.frame_px:
        left_out = 1 - found.compared_px / found.frame_px
        sentence += f"; {_percent(left_out)} were not compared"
    return sentence


def size_text(spot: SpotLimit, limit: DetectionLimit) -> str:
    """Return the width of a spot as people read it."""
    text = f"{spot.spot_sigma_px:g} px"
    if spot.spot_sigma_mm is None:
        return text
    return f"{text} ({spot.spot_sigma_mm:.2g} mm{_WHERE[limit.pixel_size_on or 'scene']})"


def _percent(share: float) -> str:
    """Of nearly all or nearly none, never all or none."""
    if 0 < share < 0.01 or 0.99 < share < 1:
        return f"{100 * share:.1f} %"
    return f"{100 * share:.0f} %"
