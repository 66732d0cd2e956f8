from ._dataset import (
    DATASET_NAME as DATASET_NAME,
    DatasetCall as DatasetCall,
    SrDatasetSummary as SrDatasetSummary,
    pair_files_in as pair_files_in,
    write_sr_dataset as write_sr_dataset,
)
from ._pairs import (
    SPLITS as SPLITS,
    PairPhotograph as PairPhotograph,
    Split as Split,
    SrDatasetSettings as SrDatasetSettings,
    png_bytes as png_bytes,
    split_of as split_of,
)
