"""A photograph as the same camera would take it from another pose, by any model."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from acquisition.photographs import photograph_of
from acquisition.provenance import Provenance
from simulation.arrays import Float32Array
from simulation.by_value import ByValue
from simulation.choices import (
    KernelModel,
    Model,
)
from simulation.followup import (
    CaptureOptions as CaptureOptions,
    FollowUp as FollowUp,
    zoomed_out as zoomed_out,
)
from simulation.notebook import html_table
from standoff.errors import ArgumentError
from standoff.library.files import FLOAT_IMAGES, write_float_tiff, write_mask
from standoff.library.followup.learned_kernel import FoundKernel
from standoff.library.followup.uncertainty import (
    SimulationUncertainty,
)
from standoff.library.inputs import FilePath, output_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedPhotograph(ByValue):
    """A simulated follow-up; ``numpy.asarray`` of it is its image.

    Parameters
    ----------
    image
        As the camera delivers it, in the levels of the reference.
    followup
        The output of the capture model behind it, and the masks of another pose.
    source, pose, model
        The photograph, the pose in words, and the capture model.
    zoom
        None for another pose.
    kernel
        What a model learned, if it does.
    uncertainty
        Standard error of each pixel, if it was asked for.
    notes
        What there is to say of it, in sentences.
    """

    image: Float32Array
    followup: FollowUp
    source: str
    pose: str
    model: Model | KernelModel
    zoom: float | None
    kernel: FoundKernel | None
    provenance: Provenance
    notes: tuple[str, ...] = ()
    uncertainty: SimulationUncertainty | None = None

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.image, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        rows, cols = self.image.shape[:2]
        return f"<SimulatedPhotograph of {self.source}: {cols} x {rows} px, {self.how}>"

    def _repr_html_(self) -> str:
        facts = [(name, str(value)) for name, value in self.to_json().items() if name not in _LONG]
        return html_table("simulated photograph", ("", ""), facts)

    @property
    def how(self) -> str:
        """Pose and model in words."""
        return f"{self.pose}, model {self.model}"

    @property
    def mask_fractions(self) -> dict[str, float]:
        """Shares that would be sharper than the reference, and that it does not show."""
        followup = self.followup
        masks = (("nearer", followup.nearer), ("outside", followup.outside))
        return {f"{name}_fraction": float(m.mean()) for name, m in masks if m is not None}

    def to_json(self) -> dict[str, Any]:
        """Return the figures as ``standoff simulate --json`` prints them, without the file."""
        form, kernel = self.followup.psf_form, self.kernel
        learned = (
            {}
            if kernel is None
            else {
                "kernel": str(kernel.path),
                "kernel_from_cache": kernel.is_from_cache,
                "kernel_covariance_px2": kernel.kernel.covariance_px2.tolist(),
            }
        )
        return {
            "image": self.source,
            "zoom": self.zoom,
            "model": self.model,
            "transfer": "gaussian" if form in (None, "gaussian") else "measured",
            "psf_form": form,
            "psf_field": self.followup.is_field,
            "size": [self.image.shape[1], self.image.shape[0]],
            "min": float(self.image.min()),
            "max": float(self.image.max()),
            **(self.mask_fractions if self.zoom is None else {}),
            **learned,
            "uncertainty": None if self.uncertainty is None else self.uncertainty.to_json(),
            "provenance": self.provenance.model_dump(mode="json"),
        }

    def write(self, path: FilePath) -> None:
        """Write the image as a float32 TIFF, whole or not at all.

        Raises
        ------
        ArgumentError
            If the name ends in neither ``.tif`` nor ``.tiff``.
        ImageFileError
            If the file cannot be written.
        """
        description = f"standoff simulate: {self.how}, of {Path(self.source).name}"
        write_float_tiff(output_path(path, "path", FLOAT_IMAGES), self.image, description)

    def write_nearer(self, path: FilePath) -> None:
        """Write the mask of pixels that would be sharper than the reference, as PNG.

        Raises
        ------
        ArgumentError
            If the follow-up is merely further away: then there are none.
        ImageFileError
            If the file cannot be written.
        """
        if self.followup.nearer is None:
            raise ArgumentError("only a follow-up of another pose has pixels that are nearer")
        write_mask(output_path(path, "path", {".png"}), self.followup.nearer)

    def write_uncertainty(self, path: FilePath) -> None:
        """Write the standard error of each pixel as a float32 TIFF, whole or not at all.

        Raises
        ------
        ArgumentError
            If it was not asked for.
        ImageFileError
            If the file cannot be written.
        """
        if self.uncertainty is None:
            raise ArgumentError("the uncertainty was not computed; simulate with uncertainty")
        description = (
            f"standoff simulate: standard error of {self.how}, of {Path(self.source).name}"
        )
        write_float_tiff(output_path(path, "path", FLOAT_IMAGES), self.uncertainty.err, description)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the follow-up as a screen shows it."""
        return photograph_of(self.image, f"{Path(self.source).name}: {self.how}").plot(ax)


_LONG = ("provenance", "kernel_covariance_px2")
