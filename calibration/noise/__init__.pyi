from ._document import (
    CorrectionMaps as CorrectionMaps,
    MapFile as MapFile,
    NoiseCalibration as NoiseCalibration,
    map_paths as map_paths,
    read_map_files as read_map_files,
    write_map_files as write_map_files,
)
from ._emva import EmvaRow as EmvaRow, EmvaSheet as EmvaSheet, emva_sheet as emva_sheet
from ._measurement import (
    FrameGroup as FrameGroup,
    NoiseCaptures as NoiseCaptures,
    NoiseKind as NoiseKind,
    NoiseMeasurement as NoiseMeasurement,
    noise_captures as noise_captures,
    noise_of_captures as noise_of_captures,
)
from ._pattern import (
    PatternParts as PatternParts,
    PatternSpectra as PatternSpectra,
    pattern_parts as pattern_parts,
    pattern_spectra as pattern_spectra,
    share_passed as share_passed,
)
from ._photon_transfer import (
    LevelNoise as LevelNoise,
    LevelSample as LevelSample,
    Linearity as Linearity,
    PhotonTransfer as PhotonTransfer,
    Saturation as Saturation,
    draw_photon_transfer as draw_photon_transfer,
    fit_level_noise as fit_level_noise,
    fit_photon_transfer as fit_photon_transfer,
    level_noise as level_noise,
)
