from .camera import SessionCamera as SessionCamera
from .plans import height_scan as height_scan
from .stage import HeightStage as HeightStage
from .status import WorkStatus as WorkStatus
