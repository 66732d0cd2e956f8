from .choices import PairFormat as PairFormat
from .dataset import SrDatasetSummary as SrDatasetSummary, write_sr_dataset as write_sr_dataset
from .settings import SrDatasetSettings as SrDatasetSettings

__all__ = [
    "PairFormat",
    "SrDatasetSettings",
    "SrDatasetSummary",
    "write_sr_dataset",
]
