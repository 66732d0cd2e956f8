from .field import PsfField as PsfField, field_monomials as field_monomials
from .gaussian import GaussianPsf as GaussianPsf
from .transfer import (
    CameraTransfer as CameraTransfer,
    GaussianTransfer as GaussianTransfer,
    SampledTransfer as SampledTransfer,
    Transfer as Transfer,
)

__all__ = [
    "CameraTransfer",
    "GaussianPsf",
    "GaussianTransfer",
    "PsfField",
    "SampledTransfer",
    "Transfer",
    "field_monomials",
]
