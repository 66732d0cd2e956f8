from ._crops import CropPicker as CropPicker, KernelGanError as KernelGanError
from ._estimate import (
    EstimatedKernel as EstimatedKernel,
    KernelGanSettings as KernelGanSettings,
    estimate_kernel as estimate_kernel,
    kernel_operator as kernel_operator,
)
from ._training import (
    DeepLinearGenerator as DeepLinearGenerator,
    KernelGanTraining as KernelGanTraining,
    composed_kernel as composed_kernel,
    sampled as sampled,
)
