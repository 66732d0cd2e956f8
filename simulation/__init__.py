"""The capture model: how a scene looks from further away."""

from simulation.grid import SamplingGrid
from simulation.psf import GaussianPsf
from simulation.zoom import MODELS, Model, ZoomOperator, zoom_operator, zoom_out, zoom_out_on_grid

__all__ = [
    "MODELS",
    "GaussianPsf",
    "Model",
    "SamplingGrid",
    "ZoomOperator",
    "zoom_operator",
    "zoom_out",
    "zoom_out_on_grid",
]
