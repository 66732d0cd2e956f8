from ._information import (
    edge_information_bits_per_px as edge_information_bits_per_px,
    information_bits_per_px as information_bits_per_px,
)
from ._quanta import (
    ROSE_SNR as ROSE_SNR,
    Bar as Bar,
    Disc as Disc,
    GaussianSpot as GaussianSpot,
    NoisePower as NoisePower,
    SignalAndNoise as SignalAndNoise,
    Transfer as Transfer,
    edge_location_err_px as edge_location_err_px,
    edge_shift_snr as edge_shift_snr,
    ideal_observer_snr as ideal_observer_snr,
)
