from ._control import (
    ManualStage as ManualStage,
    StageReport as StageReport,
    act_on_stage as act_on_stage,
)
from ._grbl import open_grbl_stage as open_grbl_stage
from ._grbl_setup import expected_envelopes as expected_envelopes
from ._motor import (
    MotorStage as MotorStage,
    home_timeout_s as home_timeout_s,
    move_timeout_s as move_timeout_s,
    refuse_beyond_limits as refuse_beyond_limits,
)
from ._serial_link import (
    SerialLink as SerialLink,
    open_serial_port as open_serial_port,
)
from .zaber import open_zaber_stage as open_zaber_stage
