"""A capture that a script took at the bench, outside any session."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from acquisition.devices import CameraSettings
from acquisition.photographs import Photograph
from simulation.by_value import ByValue
from simulation.notebook import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchCapture(ByValue):
    """The mean of some frames at one height, with their temporal variance.

    ``numpy.asarray`` of it is ``mean_dn``, and every function of the library that takes an image
    takes it.

    Parameters
    ----------
    mean_dn
        Shape ``(rows, cols)``, in DN, linear in light, black level included.
    variance_dn2
        Of one frame, in DN^2: the mean has ``variance_dn2 / frames_used``.
    height_mm
        As read back from the stage.
    settings
        The camera's, as read back: exposure, gain, format, black level.
    saturated_pixels
        Pixels that reached the largest level in any frame.
    focus_value
        Squared gradient over the frame, noise subtracted.
    """

    mean_dn: NDArray[np.float32] = field(repr=False)
    variance_dn2: NDArray[np.float32] = field(repr=False)
    height_mm: float
    frames_used: int
    settings: CameraSettings
    saturated_pixels: int
    focus_value: float

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.mean_dn, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        rows, cols = self.mean_dn.shape
        return (
            f"<BenchCapture at {self.height_mm:.3f} mm: {cols} x {rows} px, {self.frames_used} "
            f"frames of {self.exposure_us:g} us, focus {self.focus_value:.4g}>"
        )

    def _repr_html_(self) -> str:
        facts = [
            ("height / mm", f"{self.height_mm:.3f}"),
            ("frames", str(self.frames_used)),
            ("exposure / us", f"{self.exposure_us:g}"),
            ("gain / dB", f"{self.settings.gain_db:g}"),
            ("saturated pixels", str(self.saturated_pixels)),
            ("focus value", f"{self.focus_value:.4g}"),
        ]
        return html_table("capture", ("", ""), facts)

    @property
    def exposure_us(self) -> float:
        """Exposure time of one frame, in us."""
        return self.settings.exposure_us

    @property
    def photograph(self) -> Photograph:
        """The capture as the functions on photographs take it, with its noise."""
        return Photograph(
            path=Path(f"capture at {self.height_mm:.3f} mm"),
            stored=self.mean_dn,
            saturation_dn=float(self.settings.max_level_dn),
            variance_dn2=self.variance_dn2.astype(np.float64),
            frames=self.frames_used,
        )

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the capture as a screen shows it."""
        return self.photograph.plot(ax)
