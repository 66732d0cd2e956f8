"""The capture model: how a scene looks from further away."""

from simulation.field import PsfField
from simulation.grid import SamplingGrid
from simulation.pose import SimulatedPose, simulate_pose
from simulation.psf import GaussianPsf
from simulation.transfer import CameraTransfer, GaussianTransfer, SampledTransfer, Transfer
from simulation.zoom import (
    MODELS,
    Model,
    ZoomOperator,
    lmmse_operator,
    zoom_operator,
    zoom_out,
    zoom_out_on_grid,
)

__all__ = [
    "MODELS",
    "CameraTransfer",
    "GaussianPsf",
    "GaussianTransfer",
    "Model",
    "PsfField",
    "SampledTransfer",
    "SamplingGrid",
    "SimulatedPose",
    "Transfer",
    "ZoomOperator",
    "lmmse_operator",
    "simulate_pose",
    "zoom_operator",
    "zoom_out",
    "zoom_out_on_grid",
]
