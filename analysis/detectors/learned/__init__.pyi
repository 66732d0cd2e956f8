from .training import (
    TrainingOptions as TrainingOptions,
    TrainingPair as TrainingPair,
    train_detector as train_detector,
)
from .weights import (
    LearnedDetector as LearnedDetector,
    export_onnx as export_onnx,
    load_learned as load_learned,
    save_learned as save_learned,
)
