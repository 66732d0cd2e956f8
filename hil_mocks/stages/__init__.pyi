from .grbl import GrblFirmware as GrblFirmware
from .serial_line import LineFaults as LineFaults, SerialLine as SerialLine
from .serial_stage import SerialStage as SerialStage, StageProtocol as StageProtocol
