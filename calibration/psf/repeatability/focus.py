"""How well the focus of a camera repeats, as psf.json stores it."""

from math import sqrt
from typing import Literal

from pydantic import BaseModel, ConfigDict

from calibration.psf.repeatability.mixed_model import SCATTERS_P, CaptureFit


class FocusScatter(BaseModel):
    """How much the variance of the PSF, averaged over both axes, scatters between captures.

    Attributes
    ----------
    scatter_px2, scatter_err_px2
        Standard deviation between captures beyond what the edges' errors and their scatter within
        captures explain, and its standard error.
    mean_err_px2
        What it leaves in the mean variance of this calibration, and its errors hold: the scatter
        over the root of the number of captures, where these have as many edges each. 0 where the
        captures do not differ significantly.
    captures
        Number of captures.
    freedom
        Student's degrees of freedom between captures, with which all of this is known.
    p_value
        Of so much difference between captures if their focus were the same.
    source
        What it was estimated from.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    scatter_px2: float
    scatter_err_px2: float
    mean_err_px2: float
    captures: int
    freedom: float | None = None
    p_value: float | None = None
    source: Literal["captures"] = "captures"

    @classmethod
    def of(cls, fit: CaptureFit) -> "FocusScatter":
        """Return the scatter between the captures of a calibration."""
        scatter = sqrt(fit.scatter2_px4)
        return cls(
            scatter_px2=scatter,
            scatter_err_px2=scatter_err(fit.scatter2_px4, fit.scatter2_err_px4),
            mean_err_px2=_mean_err(fit, scatter),
            captures=fit.captures,
            freedom=float(fit.between),
            p_value=fit.p_value,
        )


def scatter_err(scatter2: float, scatter2_err: float) -> float:
    """Return the standard error of a scatter from that of its square.

    Near zero the square is what has a normal error, and the root is as unsure as the root of that.
    """
    scatter = sqrt(scatter2)
    if scatter2_err > scatter2:
        return sqrt(scatter2 + scatter2_err) - scatter
    return scatter2_err / (2 * scatter)


def _mean_err(fit: CaptureFit, scatter_px2: float) -> float:
    if fit.is_single and fit.p_value < SCATTERS_P:
        return scatter_px2 / sqrt(fit.captures)
    return fit.shared_err_px2 if fit.is_scattered else 0.0
