"""The figures of the paper's Tables I and II, to stand beside ours.

Source: *Modeling the effect of relative camera pose differences on change detection tasks*,
Tables I and II.
"""

from dataclasses import dataclass

from analysis.validation_models import ValidationModel

__all__ = ["PAPER_TABLE_1", "PAPER_TABLE_2", "PaperRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperRow:
    """One row of a table as printed; the attributes are named like those of ``ImageMetrics``."""

    correlation: float
    mse_dn2: float
    nmi: float
    psnr_db: float
    ssim: float


PAPER_TABLE_1: dict[ValidationModel, PaperRow] = {
    "bicubic": PaperRow(correlation=0.0059, mse_dn2=22863, nmi=0.0256, psnr_db=53.8, ssim=0.062),
    "kernelgan": PaperRow(correlation=0.0017, mse_dn2=5598, nmi=0.0062, psnr_db=16.1, ssim=0.013),
    "paper": PaperRow(correlation=0.0004, mse_dn2=2320, nmi=0.0052, psnr_db=9.7, ssim=0.005),
}
"""Mean squared differences between the curves."""

PAPER_TABLE_2: dict[ValidationModel, PaperRow] = {
    "bicubic": PaperRow(correlation=0.953, mse_dn2=86, nmi=1.256, psnr_db=36.6, ssim=0.733),
    "kernelgan": PaperRow(correlation=0.944, mse_dn2=104, nmi=1.213, psnr_db=34.8, ssim=0.677),
    "paper": PaperRow(correlation=0.968, mse_dn2=64, nmi=1.275, psnr_db=37.8, ssim=0.760),
}
"""Means over pairs of captured and simulated follow-ups."""
