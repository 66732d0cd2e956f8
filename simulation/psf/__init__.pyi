from .field import PsfField as PsfField, field_monomials as field_monomials
from .gaussian import GaussianPsf as GaussianPsf
from .lens import LensOtf as LensOtf, pupil_otf as pupil_otf
from .measured import (
    MeasuredPsf as MeasuredPsf,
    Psf as Psf,
    SeparablePsf as SeparablePsf,
)
from .transfer import (
    GaussianTransfer as GaussianTransfer,
    SampledTransfer as SampledTransfer,
    Transfer as Transfer,
)

__all__ = [
    "GaussianPsf",
    "GaussianTransfer",
    "LensOtf",
    "MeasuredPsf",
    "Psf",
    "PsfField",
    "SampledTransfer",
    "SeparablePsf",
    "Transfer",
    "field_monomials",
    "pupil_otf",
]
