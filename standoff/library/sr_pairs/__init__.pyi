from .choices import PairFormat as PairFormat
from .dataset import (
    SrDatasetSummary as SrDatasetSummary,
    SweepOptions as SweepOptions,
    training_pairs as training_pairs,
    write_sr_dataset as write_sr_dataset,
)
from .settings import SrDatasetSettings as SrDatasetSettings
