"""What a comparison would have found, in sentences."""

from analysis.changes.document import ChangeSummary
from analysis.detection_limits import percent_text, prediction_sentence, spot_sentence


def describe_limit(found: ChangeSummary) -> str | None:
    """Say which spots would have been found; None in files of before."""
    if found.detection_limit is None:
        return None
    sentence = spot_sentence(found.detection_limit)
    if found.frame_px:
        left_out = 1 - found.compared_px / found.frame_px
        sentence += f"; {percent_text(left_out)} were not compared"
    return sentence


def describe_prediction(found: ChangeSummary) -> str | None:
    """Say how the limit and the predicted one compare; None where nothing was predicted."""
    limit = found.detection_limit
    if limit is None or limit.predicted is None:
        return None
    return prediction_sentence(limit.predicted)
