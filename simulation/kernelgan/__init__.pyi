from .crops import CropPicker as CropPicker
from .errors import KernelGanError as KernelGanError
from .estimate import (
    EstimatedKernel as EstimatedKernel,
    KernelGanSettings as KernelGanSettings,
    estimate_kernel as estimate_kernel,
)
from .generator import (
    DeepLinearGenerator as DeepLinearGenerator,
    composed_kernel as composed_kernel,
    sampled as sampled,
)
from .sampling import kernel_operator as kernel_operator
from .training import KernelGanTraining as KernelGanTraining
