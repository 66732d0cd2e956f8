from simulation.choices import (
    KERNEL_MODELS as KERNEL_MODELS,
    TRAINING_STEPS as TRAINING_STEPS,
    KernelModel as KernelModel,
    Sampler as Sampler,
)

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

__all__ = [
    "KERNEL_MODELS",
    "TRAINING_STEPS",
    "CropPicker",
    "DeepLinearGenerator",
    "EstimatedKernel",
    "KernelGanError",
    "KernelGanSettings",
    "KernelGanTraining",
    "KernelModel",
    "Sampler",
    "composed_kernel",
    "estimate_kernel",
    "kernel_operator",
    "sampled",
]
