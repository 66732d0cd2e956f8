from .choices import MODELS as MODELS, Model as Model
from .pose.options import PoseOptions as PoseOptions
from .pose.simulate import SimulatedPose as SimulatedPose, simulate_pose as simulate_pose
from .psf.field import PsfField as PsfField
from .psf.gaussian import GaussianPsf as GaussianPsf
from .psf.lens import LensOtf as LensOtf
from .psf.measured import MeasuredPsf as MeasuredPsf, Psf as Psf, SeparablePsf as SeparablePsf
from .psf.tabulated import TabulatedPsf as TabulatedPsf
from .psf.transfer import (
    GaussianTransfer as GaussianTransfer,
    SampledTransfer as SampledTransfer,
    Transfer as Transfer,
)
from .resampling.grid import SamplingGrid as SamplingGrid
from .zoom import (
    ZoomOperator as ZoomOperator,
    lmmse_operator as lmmse_operator,
    zoom_operator as zoom_operator,
    zoom_out as zoom_out,
    zoom_out_on_grid as zoom_out_on_grid,
)
