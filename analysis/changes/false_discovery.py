"""How many peaks chance makes in a smooth field, and the false share of those that were found."""

from analysis.changes.change_list import ComparedGrid


def discovery_threshold(compared: ComparedGrid, rate: float) -> float:
    """Lowest threshold in standard deviations at which this share of the changes is false.

    Parameters
    ----------
    compared
        The smoothed difference with its standard deviation.
    rate
        Share of false changes among those listed, above 0 and below 1.
    """
    raise NotImplementedError
