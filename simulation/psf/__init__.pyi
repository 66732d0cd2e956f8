from .correction import (
    CORRECTION_HARMONICS as CORRECTION_HARMONICS,
    CORRECTION_KNOTS_CY_PER_PX as CORRECTION_KNOTS_CY_PER_PX,
    CORRECTION_SPLINES as CORRECTION_SPLINES,
    OtfCorrection as OtfCorrection,
    correction_harmonics as correction_harmonics,
    correction_roughness as correction_roughness,
    correction_splines as correction_splines,
)
from .field import PsfField as PsfField, field_monomials as field_monomials
from .gaussian import GaussianPsf as GaussianPsf
from .lens import (
    DEFOCUS_MAX_WAVES as DEFOCUS_MAX_WAVES,
    LensOtf as LensOtf,
    SymmetricMatrix as SymmetricMatrix,
    pupil_otf as pupil_otf,
    pupil_slopes as pupil_slopes,
)
from .measured import (
    MeasuredPsf as MeasuredPsf,
    Psf as Psf,
    SeparablePsf as SeparablePsf,
)
from .tabulated import TabulatedPsf as TabulatedPsf
from .transfer import (
    GaussianTransfer as GaussianTransfer,
    SampledTransfer as SampledTransfer,
    Transfer as Transfer,
)
