"""Names of models that callers of this package choose from; imports no library."""

from typing import Literal, get_args

Model = Literal["bicubic", "paper", "matched", "lmmse"]
MODELS: tuple[Model, ...] = get_args(Model)
"""Capture models, which ``simulation.zoom`` explains."""

PoseModel = Literal["matched", "lmmse"]
POSE_MODELS: tuple[PoseModel, ...] = get_args(PoseModel)
"""The models that take any pose, a PSF of any shape, and a PSF that varies over the frame."""

DEFAULT_MODEL: PoseModel = "lmmse"
"""Over lenses, zooms, poses and noise it has the least error, as
``benchmarks/studies/capture_model.py`` shows."""

PsfForm = Literal["gaussian", "separable", "round", "elliptic", "free", "own"]
"""What a PSF's shape is known as: a Gaussian, a curve along either axis, a lens of the same
sharpness in every direction, one of two, one with a measured correction to it, or a table of one's
own."""

PsfShape = Literal["best", "gaussian", "measured"]
"""Which PSF of a psf.json is used: the best one, the Gaussian, or none but a measured one."""

GaussianForm = Literal["transfer", "sampled"]
"""How a Gaussian becomes a kernel: by its transfer function, or sampled as in libraries."""

KernelModel = Literal["kernelgan", "gaussian-kernelgan"]
KERNEL_MODELS: tuple[KernelModel, ...] = get_args(KernelModel)
"""Models that learn their kernel from the photograph: a free kernel, or a Gaussian."""

Sampler = Literal["exact", "nearest"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)
"""How a learned kernel's image is sampled, which ``simulation.kernelgan`` explains."""

TRAINING_STEPS = 3000  # Bell-Kligler et al. 2019, section 4.3
