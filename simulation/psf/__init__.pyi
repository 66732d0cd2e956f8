from .lens import (
    CORRECTION_HARMONICS as CORRECTION_HARMONICS,
    CORRECTION_SPLINES as CORRECTION_SPLINES,
    DEFOCUS_MAX_WAVES as DEFOCUS_MAX_WAVES,
    LensOtf as LensOtf,
    OtfCorrection as OtfCorrection,
    SymmetricMatrix as SymmetricMatrix,
    correction_harmonics as correction_harmonics,
    correction_roughness as correction_roughness,
    correction_splines as correction_splines,
    pupil_slopes as pupil_slopes,
)
from .shapes import (
    GaussianPsf as GaussianPsf,
    MeasuredPsf as MeasuredPsf,
    Psf as Psf,
    PsfField as PsfField,
    SampledTransfer as SampledTransfer,
    SeparablePsf as SeparablePsf,
    field_monomials as field_monomials,
)
from .tabulated import TabulatedPsf as TabulatedPsf
