from .dataset import SrDatasetSummary as SrDatasetSummary, write_sr_dataset as write_sr_dataset
from .photograph import PairPhotograph as PairPhotograph
from .record import (
    ImageRecord as ImageRecord,
    PairRecord as PairRecord,
    ShardRecord as ShardRecord,
)
from .settings import SrDatasetSettings as SrDatasetSettings
