from ._grbl import GrblFirmware as GrblFirmware
from ._serial_stage import (
    LineFaults as LineFaults,
    SerialLine as SerialLine,
    SerialStage as SerialStage,
    StageProtocol as StageProtocol,
)
