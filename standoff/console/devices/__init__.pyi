from .camera_service import CameraService as CameraService
from .device_status import DeviceStatus as DeviceStatus
from .edge_reading import EdgeReading as EdgeReading
from .frame_broadcaster import (
    FrameBroadcaster as FrameBroadcaster,
    FrameCounts as FrameCounts,
    LiveFrame as LiveFrame,
)
from .frame_sampling import (
    LineProfile as LineProfile,
    PixelReading as PixelReading,
    line_profile as line_profile,
    pixel_reading as pixel_reading,
)
from .long_exposure import LONG_S as LONG_S, Exposing as Exposing
from .picture_encoder import (
    FORMS as FORMS,
    PictureEncoder as PictureEncoder,
    PictureForm as PictureForm,
)
from .picture_monitor import (
    Levels as Levels,
    PictureFacts as PictureFacts,
    PictureMonitor as PictureMonitor,
)
from .pose_monitor import (
    PoseMonitor as PoseMonitor,
    PoseView as PoseView,
    TrackerMaker as TrackerMaker,
)
from .pose_reference import tracker_maker as tracker_maker
from .reference_picture import OverlayView as OverlayView, ReferencePicture as ReferencePicture
from .sharpness_monitor import (
    FieldReading as FieldReading,
    SharpnessMonitor as SharpnessMonitor,
    SharpnessView as SharpnessView,
    field_regions as field_regions,
)
from .squareness_monitor import (
    SquarenessMonitor as SquarenessMonitor,
    SquarenessView as SquarenessView,
)
from .stage_service import StageService as StageService, StageView as StageView
