"""What a psf.json holds, as it is read: every value checked for its type."""

from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from calibration.errors import PsfFileError
from simulation.field import PsfField
from simulation.psf import GaussianPsf
from simulation.transfer import CameraTransfer, SampledTransfer

__all__ = [
    "StoredCamera",
    "StoredCurve",
    "StoredEdge",
    "StoredField",
    "StoredHeight",
    "StoredHeightTrend",
    "StoredPsf",
    "StoredTransfer",
]

_Matrix = list[list[float]]


class StoredEdge(BaseModel):
    """One edge of a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    image: str
    capture: int | None
    height_mm: float | None
    x_px: float
    y_px: float
    angle_deg: float
    orientation: Literal["vertical", "horizontal", "diagonal"]
    length_px: float
    snr: float | None
    sigma_px: float
    sigma_err_px: float
    optical_sigma_px: float | None
    optical_sigma_err_px: float | None
    mtf50_cy_per_px: float
    chi2_reduced: float | None
    flags: list[str]
    esfr_mtf50_cy_per_px: float | None = None
    esfr_mtf50_err_cy_per_px: float | None = None
    esfr_mtf20_cy_per_px: float | None = None
    contrast: float | None = None
    roughness_px: float | None = None
    clipped_fraction: float | None = None


class StoredField(BaseModel):
    """The PSF over the frame, in a psf.json: what ``PsfField`` takes, rows xx, xy and yy.

    The coefficients without prefix are those of the total covariance.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    width_px: int
    height_px: int
    coefficients_px2: _Matrix
    optical_coefficients_px2: _Matrix | None = None
    coefficients_err_px2: _Matrix | None = None
    optical_coefficients_err_px2: _Matrix | None = None
    p_value: float | None = None
    worst_err: float | None = None
    edges: int | None = None


class StoredHeight(BaseModel):
    """Width at one height over that of the whole calibration, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    height_mm: float
    edges: int
    relative_width: float
    relative_width_err: float
    sigma_x_px: float | None = None
    sigma_x_err_px: float | None = None
    sigma_y_px: float | None = None
    sigma_y_err_px: float | None = None


class StoredHeightTrend(BaseModel):
    """Whether the width changes with the camera's height, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    slope_per_mm: float
    slope_err_per_mm: float
    p_value: float
    p_value_between: float
    is_drift: bool
    heights: list[StoredHeight]


class StoredCurve(BaseModel):
    """A transfer function along one axis, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    freq_cy_per_px: list[float]
    mtf: list[float]
    edges: int | None = None


class StoredTransfer(BaseModel):
    """Measured transfer functions along both axes, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    x: StoredCurve | None = None
    y: StoredCurve | None = None


class StoredCamera(BaseModel):
    """The camera that a psf.json belongs to, as far as it is known."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    serial: str | None = None
    model: str | None = None
    vendor: str | None = None


class StoredPsf(BaseModel):
    """What a psf.json holds; None for what its edges did not determine.

    sigma without prefix is the total PSF. Only the total values need to be there.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    sigma_x_px: float | None = None
    sigma_y_px: float | None = None
    rho: float | None = None
    covariance_px2: _Matrix | None = None
    sigma_x_err_px: float | None = None
    sigma_y_err_px: float | None = None
    rho_err: float | None = None
    optical_sigma_x_px: float | None = None
    optical_sigma_y_px: float | None = None
    optical_sigma_x_err_px: float | None = None
    optical_sigma_y_err_px: float | None = None
    optical_rho: float | None = None
    optical_rho_err: float | None = None
    optical_covariance_px2: _Matrix | None = None
    intervals_95: dict[str, tuple[float, float]] = {}
    field: StoredField | None = None
    method: str | None = None
    edges: list[StoredEdge] = []
    height_trend: StoredHeightTrend | None = None
    transfer: StoredTransfer | None = None
    camera: StoredCamera | None = None
    captured_utc: str | None = None
    region: str | None = None
    channel: str | None = None
    channels: "dict[str, StoredPsf] | None" = None

    def total_psf(self, source: str) -> GaussianPsf:
        """Return the total PSF; a correlation that is not given is taken as none.

        Raises
        ------
        PsfFileError
            If a width is null; the message names ``source`` and the width.
        """
        for name, edges in (("sigma_x_px", "vertical"), ("sigma_y_px", "horizontal")):
            if getattr(self, name) is None:
                raise PsfFileError(
                    f"{source}: {name} is null: its edges do not determine it; "
                    f"calibrate with {edges} edges as well"
                )
        try:
            return GaussianPsf(
                sigma_x_px=float(self.sigma_x_px or 0.0),
                sigma_y_px=float(self.sigma_y_px or 0.0),
                rho=self.rho or 0.0,
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: {error}") from error

    def total_field(self, source: str) -> PsfField | None:
        """Return the total PSF over the frame, None where the file has none.

        Raises
        ------
        PsfFileError
            If its coefficients make no PSF; the message names ``source``.
        """
        if self.field is None:
            return None
        try:
            return PsfField(
                width_px=self.field.width_px,
                height_px=self.field.height_px,
                coefficients_px2=np.array(self.field.coefficients_px2, dtype=np.float64),
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: field: {error}") from error

    def measured_transfer(self, source: str) -> CameraTransfer:
        """Return the transfer functions that the edges show, with no Gaussian assumed.

        Raises
        ------
        PsfFileError
            If an axis has none, or its samples are no transfer function.
        """
        curves = []
        for axis, edges in (("y", "horizontal"), ("x", "vertical")):
            stored: StoredCurve | None = getattr(self.transfer, axis, None)
            if stored is None:
                raise PsfFileError(
                    f"{source}: it holds no transfer function along {axis}; "
                    f"calibrate with {edges} edges"
                )
            try:
                curves.append(SampledTransfer(stored.freq_cy_per_px, stored.mtf))
            except ValueError as error:
                raise PsfFileError(f"{source}: transfer.{axis}: {error}") from error
        return CameraTransfer(along_y=curves[0], along_x=curves[1])
