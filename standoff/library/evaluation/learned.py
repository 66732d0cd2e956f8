"""A detector that learns from change pairs, as the public interface offers it."""

from analysis.detectors.learned import (
    LearnedDetector as LearnedDetector,
    TrainingOptions as TrainingOptions,
    export_onnx as export_onnx,
    load_learned as load_learned,
    save_learned as save_learned,
    train_detector as train_detector,
)
