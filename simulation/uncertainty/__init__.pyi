from .budget import (
    SOURCES as SOURCES,
    KnownErrors as KnownErrors,
    PixelUncertainty as PixelUncertainty,
    pixel_uncertainty as pixel_uncertainty,
)
from .psf_steps import PsfStep as PsfStep, principal_steps as principal_steps
from .view import SimulatedView as SimulatedView
