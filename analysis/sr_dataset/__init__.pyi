from .dataset import (
    DATASET_NAME as DATASET_NAME,
    SrDatasetSummary as SrDatasetSummary,
    pair_files_in as pair_files_in,
    write_sr_dataset as write_sr_dataset,
)
from .photograph import PairPhotograph as PairPhotograph
from .record import (
    ImageRecord as ImageRecord,
    PairRecord as PairRecord,
    ShardRecord as ShardRecord,
)
from .settings import (
    SPLITS as SPLITS,
    Split as Split,
    SrDatasetSettings as SrDatasetSettings,
    split_of as split_of,
)
