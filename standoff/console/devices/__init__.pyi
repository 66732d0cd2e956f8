from .camera_service import CameraKeeper as CameraKeeper
from .device_status import DeviceStatus as DeviceStatus
from .frame_broadcaster import FrameBoard as FrameBoard, FrameCounts as FrameCounts
from .picture_encoder import PictureEncoder as PictureEncoder
from .picture_monitor import (
    Levels as Levels,
    PictureFacts as PictureFacts,
    PictureWatch as PictureWatch,
)
from .pose_monitor import PoseView as PoseView, PoseWatch as PoseWatch, TrackerMaker as TrackerMaker
from .pose_reference import tracker_maker as tracker_maker
from .stage_service import StageKeeper as StageKeeper, StageView as StageView

__all__ = [
    "CameraKeeper",
    "DeviceStatus",
    "FrameBoard",
    "FrameCounts",
    "Levels",
    "PictureEncoder",
    "PictureFacts",
    "PictureWatch",
    "PoseView",
    "PoseWatch",
    "StageKeeper",
    "StageView",
    "TrackerMaker",
    "tracker_maker",
]
