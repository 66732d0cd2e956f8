from .dataset import (
    ChangePairsDataset as ChangePairsDataset,
    ChangePairsFile as ChangePairsFile,
    read_dataset as read_dataset,
    write_change_pairs as write_change_pairs,
)
from .pair_file import LabelledPair as LabelledPair
from .random_conditions import ChangePairsTask as ChangePairsTask, labelled_pairs as labelled_pairs
from .work import ChangePairsWork as ChangePairsWork
