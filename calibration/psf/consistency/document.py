"""What the cross-validation of a calibration found, as psf.json stores it."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

MisfitKind = Literal["soft_target", "stage", "focus_drift", "focus_scatter", "shape", "edges"]


class HalvesCheck(BaseModel):
    """How well one half of the edges predicts the widths of the other.

    ``chi2_reduced`` is near 1 where the errors of the edges explain what is left.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    chi2_reduced: float
    freedom: int
    p_value: float


class Misfit(BaseModel):
    """One thing that does not fit, in words, and how strongly it shows.

    ``p_value`` is after Holm's correction for all tests that were made.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    kind: MisfitKind
    p_value: float
    sentence: str


class CrossValidation(BaseModel):
    """Whether the edges agree with one PSF, and the name of what does not fit.

    Attributes
    ----------
    edges
        Every other edge of each capture predicts the rest; null where a half does not determine
        the widths.
    heights
        The nearer half of the captures predicts the further one; without heights, every other
        capture the rest.
    p_values
        Of the tests by their kind, before the correction; a test that could not be made is absent.
    named
        What does not fit, empty where all tests together give no reason to doubt the model.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    edges: HalvesCheck | None
    heights: HalvesCheck | None
    p_values: dict[MisfitKind, float]
    named: tuple[Misfit, ...]
