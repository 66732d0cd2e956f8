from .choices import (
    MODELS as MODELS,
    Model as Model,
)
from .pose.depth import SceneDepth as SceneDepth
from .pose.simulate import (
    SimulatedPose as SimulatedPose,
    simulate_pose_of_image as simulate_pose_of_image,
)
from .pose.view import PoseOptions as PoseOptions
from .psf.lens import LensOtf as LensOtf
from .psf.shapes import (
    GaussianPsf as GaussianPsf,
    MeasuredPsf as MeasuredPsf,
    Psf as Psf,
    PsfField as PsfField,
    SampledTransfer as SampledTransfer,
    SeparablePsf as SeparablePsf,
    Transfer as Transfer,
)
from .psf.tabulated import TabulatedPsf as TabulatedPsf
from .sampling_grid import SamplingGrid as SamplingGrid
from .zoom import (
    ZoomOperator as ZoomOperator,
    lmmse_operator as lmmse_operator,
    zoom_operator as zoom_operator,
    zoom_out_image as zoom_out_image,
    zoom_out_on_grid as zoom_out_on_grid,
)
