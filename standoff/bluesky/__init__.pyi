from .camera import SessionCamera as SessionCamera
from .plans import height_scan as height_scan
from .stage import HeightStage as HeightStage
from .status import WorkStatus as WorkStatus

__all__ = ["HeightStage", "SessionCamera", "WorkStatus", "height_scan"]
