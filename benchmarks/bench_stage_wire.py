"""The stage's wire format and connection beside bare pyserial.

Run with ``python benchmarks/bench_stage_wire.py``.
"""

import platform
from collections.abc import Callable
from importlib.metadata import version
from statistics import median
from time import monotonic, perf_counter

import serial

from acquisition.grbl_controller import GrblController
from acquisition.grbl_wire import parse_line
from acquisition.serial_link import SerialLink
from acquisition.serial_port import open_serial_port
from acquisition.zaber_wire import checksum, parse_message
from hil_mocks.serial_stage import SerialStage

REPORT = b"<Jog|MPos:0.000,0.000,-98.000|Bf:15,128|FS:1200,0|Ov:100,100,100>"
REPLY_BODY = "01 1 07 OK BUSY -- 246063"
REPLY = f"@{REPLY_BODY}:{checksum(REPLY_BODY):02X}".encode("ascii")
LINES = 20_000
ROUND_TRIPS = 300
BYTES_PER_S = 11_520
"""115200 baud, 8N1."""


def seconds(work: Callable[[], object]) -> float:
    begin = perf_counter()
    work()
    return perf_counter() - begin


def line_rate(parse: Callable[[bytes], object], line: bytes) -> float:
    """Lines per second."""
    return LINES / min(seconds(lambda: [parse(line) for _ in range(LINES)]) for _ in range(3))


def bare_round_trip_s(path: str) -> float:
    with serial.Serial(path, 115200, timeout=1) as port:

        def ask() -> None:
            port.write(b"?")
            port.readline()

        return median(seconds(ask) for _ in range(ROUND_TRIPS))


def driver_round_trip_s(path: str) -> float:
    link = SerialLink(open_serial_port(path, 115200), name="the stage", clock=monotonic)
    controller = GrblController(link, clock=monotonic)
    controller.get_in_step(may_boot=True)
    try:
        return median(seconds(controller.status) for _ in range(ROUND_TRIPS))
    finally:
        controller.close()


def main() -> None:
    print(f"Python {platform.python_version()}, pyserial {version('pyserial')}")
    for name, parse, line in (("Grbl", parse_line, REPORT), ("Zaber", parse_message, REPLY)):
        rate = line_rate(parse, line)
        wire = BYTES_PER_S / (len(line) + 2)
        print(f"{name}: {rate:9.0f} lines/s, {rate / wire:5.0f} times what 115200 baud carries")
    with SerialStage("grbl") as stage:
        bare_s = bare_round_trip_s(stage.port)
        driver_s = driver_round_trip_s(stage.port)
    print(f"status round trip: bare readline {bare_s * 1e3:.2f} ms, driver {driver_s * 1e3:.2f} ms")
    print(f"ratio driver / bare: {driver_s / bare_s:.2f} (the emulator looks every 2 ms)")


if __name__ == "__main__":
    main()
