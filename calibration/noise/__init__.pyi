from .capture_list import (
    NoiseCapture as NoiseCapture,
    NoiseCaptures as NoiseCaptures,
    NoiseKind as NoiseKind,
)
from .captures import NoiseMeasurement as NoiseMeasurement, measure_noise as measure_noise
from .correction_maps import CorrectionMaps as CorrectionMaps
from .document import (
    NOISE_SCHEMA as NOISE_SCHEMA,
    MapFile as MapFile,
    NoiseCalibration as NoiseCalibration,
    map_paths as map_paths,
    read_map_files as read_map_files,
    write_map_files as write_map_files,
)
from .frame_group import FrameGroup as FrameGroup, noise_captures as noise_captures
from .linearity import Linearity as Linearity
from .noise_by_level import (
    LevelNoise as LevelNoise,
    fit_level_noise as fit_level_noise,
    level_noise as level_noise,
)
from .photon_transfer import (
    LevelSample as LevelSample,
    PhotonTransfer as PhotonTransfer,
    Saturation as Saturation,
    fit_photon_transfer as fit_photon_transfer,
)
from .plot import draw_photon_transfer as draw_photon_transfer
