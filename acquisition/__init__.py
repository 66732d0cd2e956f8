"""Devices and capture sessions.

What reads a session, and every error, is exported here. Whoever drives devices or writes
sessions imports the module: ``acquisition.devices``, ``acquisition.runner``, ...
"""

from acquisition.capture_file import CaptureImages, read_capture
from acquisition.errors import (
    BenchConfigError,
    CameraFeatureError,
    CaptureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    DriverMissingError,
    OperatorStopError,
    PlanError,
    SessionError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
    StreamInterruptedError,
)
from acquisition.plan import CaptureKind, CapturePlan, PlanEntry, load_plan, plan_entries
from acquisition.record import CaptureRecord
from acquisition.session import FileCheck, Session, SessionCapture, VerifyReport, verify

__all__ = [
    "BenchConfigError",
    "CameraFeatureError",
    "CaptureError",
    "CaptureImages",
    "CaptureKind",
    "CapturePlan",
    "CaptureRecord",
    "DeviceDisconnectedError",
    "DeviceError",
    "DeviceInUseError",
    "DeviceProtocolError",
    "DeviceResetError",
    "DeviceTimeoutError",
    "DriverMissingError",
    "FileCheck",
    "OperatorStopError",
    "PlanEntry",
    "PlanError",
    "Session",
    "SessionCapture",
    "SessionError",
    "StageAlarmError",
    "StageLimitError",
    "StageNotHomedError",
    "StreamInterruptedError",
    "VerifyReport",
    "load_plan",
    "plan_entries",
    "read_capture",
    "verify",
]
