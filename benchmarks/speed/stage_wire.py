"""The stage's wire format and connection beside bare pyserial."""

from collections.abc import Callable
from time import monotonic

import serial

from acquisition.stages import SerialLink, open_serial_port
from acquisition.stages.grbl_controller import GrblController
from acquisition.stages.grbl_wire import parse_line
from acquisition.stages.zaber import checksum, parse_message
from benchmarks.harness import Recorder, benchmark, best_s, medians_s
from hil_mocks.stages import SerialStage

REPORT = b"<Jog|MPos:0.000,0.000,-98.000|Bf:15,128|FS:1200,0|Ov:100,100,100>"
REPLY_BODY = "01 1 07 OK BUSY -- 246063"
REPLY = f"@{REPLY_BODY}:{checksum(REPLY_BODY):02X}".encode("ascii")
LINES = 20_000
ROUND_TRIPS = 300
BYTES_PER_S = 11_520
"""115200 baud, 8N1."""


def _line_rate(parse: Callable[[bytes], object], line: bytes) -> float:
    """Lines per second."""
    return LINES / best_s(lambda: [parse(line) for _ in range(LINES)], 0.2)


def _bare_round_trip_s(path: str) -> float:
    with serial.Serial(path, 115200, timeout=1) as port:

        def ask() -> None:
            port.write(b"?")
            port.readline()

        return medians_s([ask], ROUND_TRIPS)[0]


def _driver_round_trip_s(path: str) -> float:
    link = SerialLink(open_serial_port(path, 115200), name="the stage", clock=monotonic)
    controller = GrblController(link, clock=monotonic)
    controller.get_in_step(may_boot=True)
    try:
        return medians_s([controller.status], ROUND_TRIPS)[0]
    finally:
        controller.close()


@benchmark("pyserial")
def main(record: Recorder) -> None:
    for name, parse, line in (("Grbl", parse_line, REPORT), ("Zaber", parse_message, REPLY)):
        rate = _line_rate(parse, line)
        wire = BYTES_PER_S / (len(line) + 2)
        record.figure(
            f"parse a line of {name}",
            1e6 / rate,
            "us",
            "the line itself at 115200 baud",
            1e6 / wire,
        )
    with SerialStage("grbl") as stage:
        bare_s = _bare_round_trip_s(stage.port)
        driver_s = _driver_round_trip_s(stage.port)
    record.time("status round trip", driver_s, "bare pyserial readline", bare_s)
    record.say("the emulator looks every 2 ms")
