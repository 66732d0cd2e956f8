from .control import (
    StageReport as StageReport,
    act_on_stage as act_on_stage,
)
from .manual import ManualStage as ManualStage
from .motor import MotorStage as MotorStage
from .serial_link import SerialLink as SerialLink, open_serial_port as open_serial_port
from .travel import (
    home_timeout_s as home_timeout_s,
    move_timeout_s as move_timeout_s,
    refuse_beyond_limits as refuse_beyond_limits,
)
