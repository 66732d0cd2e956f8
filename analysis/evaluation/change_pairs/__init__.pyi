from ._dataset import (
    ChangePairsDataset as ChangePairsDataset,
    ChangePairsFile as ChangePairsFile,
    ChangePairsWork as ChangePairsWork,
    read_dataset as read_dataset,
    write_change_pairs as write_change_pairs,
)
from ._pairs import (
    ChangePairsTask as ChangePairsTask,
    LabelledPair as LabelledPair,
    labelled_pairs as labelled_pairs,
)
