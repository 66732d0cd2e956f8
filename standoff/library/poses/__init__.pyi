from .pose_stream import (
    NamedFrame as NamedFrame,
    PoseWatch as PoseWatch,
    StreamSummary as StreamSummary,
    camera_frames as camera_frames,
    folder_frames as folder_frames,
    verdict_facts as verdict_facts,
)
