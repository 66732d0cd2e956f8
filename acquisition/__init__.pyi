from .errors import SessionError as SessionError
from .session import (
    CaptureImages as CaptureImages,
    CaptureRecord as CaptureRecord,
    Session as Session,
    SessionCapture as SessionCapture,
    read_capture as read_capture,
    verify as verify,
)
