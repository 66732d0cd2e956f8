"""Opens the serial line that a bench file names for its stage."""

from pathlib import Path
from time import monotonic

from acquisition.bench import StageConfig
from acquisition.errors import BenchConfigError
from acquisition.serial_link import SerialLink
from acquisition.serial_port import open_serial_port
from acquisition.wire_log import WireLog

__all__ = ["open_stage_link"]


def open_stage_link(config: StageConfig, *, name: str) -> SerialLink:
    """Open port and wire log.

    Raises
    ------
    BenchConfigError
        If the wire log cannot be written.
    DeviceDisconnectedError
        If the port cannot be opened.
    """
    try:
        log = WireLog(Path(config.wire_log)) if config.wire_log else None
    except OSError as error:
        raise BenchConfigError(f"stage.wire_log {config.wire_log}: {error.strerror}") from error
    try:
        port = open_serial_port(config.port or "", config.baud_rate)
    except BaseException:
        if log:
            log.close()
        raise
    return SerialLink(port, name=f"{name} on {config.port}", clock=monotonic, log=log)
