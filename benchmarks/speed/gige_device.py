"""What serving the simulated GigE camera costs: 67.5 frames/s of 780 x 580 px in Mono12.

The camera is a process of its own, so its
processor time is that of the device alone; this process asks for frames and throws them away.
The peer is one system call per packet, without the kernel's segmentation.
"""

import itertools
import multiprocessing
import socket
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

import hil_mocks.gige.stream
from acquisition.bench import load_bench
from benchmarks.harness import Recorder, benchmark
from hil_mocks.gige import (
    GVCP_PORT,
    PIXEL_LAYOUTS,
    BootstrapAddress,
    CommandCode,
    FrameRequest,
    PacketFormat,
    RegisterWrite,
    features_of,
    wire_bytes,
)
from hil_mocks.practice_bench import PracticeBench
from tests.hil_mocks.gige_wire import (
    encode_command,
    encode_write_memory,
    encode_write_registers,
    parse_packet,
)

CONFIG = Path(__file__).parents[2] / "configs" / "simulated.toml"
ADDRESS = "127.61.1.1"
SECONDS = 4.0
REPEATS = 30
JUMBO_MTU = 9000


def _serve(pipe: Connection, max_segments: int) -> None:
    """Serve until told to stop; then send the processor seconds used since the first word."""
    hil_mocks.gige.stream.MAX_SEGMENTS = max_segments
    bench = PracticeBench(
        load_bench(CONFIG), height_mm=lambda: 200.0, address=ADDRESS, link_mtu_bytes=JUMBO_MTU
    )
    with bench:
        pipe.send("ready")
        pipe.recv()
        before_s = time.process_time()
        pipe.recv()
        pipe.send(time.process_time() - before_s)


class _Client:
    """As little of a GigE Vision client as it takes to get frames."""

    def __init__(self) -> None:
        self.control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.control.bind((ADDRESS.replace("1.1", "1.2"), 0))
        self.control.settimeout(5)
        self.stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.stream.bind((self.control.getsockname()[0], 0))
        self.stream.settimeout(5)
        self.requests = itertools.count(1)
        self.places = {
            feature.name: feature for feature in features_of(None, has_temperature=False)
        }

    def write(self, address: int, value: int) -> None:
        """Write one register."""
        payload = encode_write_registers([RegisterWrite(address=address, value=value)])
        self.exchange(encode_command(CommandCode.WRITEREG, next(self.requests), payload))

    def exchange(self, datagram: bytes) -> None:
        """Send a command and wait for its acknowledge."""
        self.control.sendto(datagram, (ADDRESS, GVCP_PORT))
        if self.control.recv(600)[:2] != b"\0\0":
            raise RuntimeError("the camera refused a command")

    def start(self, packet_size_bytes: int) -> None:
        """Take control and start the stream."""
        ip = int.from_bytes(socket.inet_aton(self.control.getsockname()[0]), "big")
        self.write(BootstrapAddress.CONTROL_PRIVILEGE, 2)
        self.write(self.places["PixelFormat"].address, PIXEL_LAYOUTS["Mono12"].code)
        for name, value in (("ExposureTimeAbs", 9000.0), ("AcquisitionFrameRateAbs", 67.5)):
            data = encode_write_memory(self.places[name].address, np.array(value, ">f8").tobytes())
            self.exchange(encode_command(CommandCode.WRITEMEM, next(self.requests), data))
        self.write(BootstrapAddress.STREAM_PACKET_SIZE, packet_size_bytes)
        self.write(BootstrapAddress.STREAM_DESTINATION, ip)
        self.write(BootstrapAddress.STREAM_PORT, self.stream.getsockname()[1])
        self.write(self.places["AcquisitionStart"].address, 1)

    def count_frames(self, seconds: float) -> float:
        """Frames per second, from trailer to trailer."""
        ends: list[float] = []
        beat_s = time.monotonic()
        while not ends or ends[-1] - ends[0] < seconds:
            if parse_packet(self.stream.recv(10_000)).header.packet_format == PacketFormat.TRAILER:
                ends.append(time.monotonic())
            if time.monotonic() - beat_s > 1:
                beat_s = time.monotonic()
                self.write(BootstrapAddress.STREAM_PACKET_DELAY, 0)
        return (len(ends) - 1) / (ends[-1] - ends[0])

    def close(self) -> None:
        """Give both ports back."""
        self.control.close()
        self.stream.close()


def _measure(packet_size_bytes: int, max_segments: int, seconds: float) -> tuple[float, float]:
    """Frames per second and share of one core."""
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=_serve, args=(theirs, max_segments), daemon=True
    )
    process.start()
    ours.recv()
    client = _Client()
    client.start(packet_size_bytes)
    client.count_frames(1.0)
    ours.send("begin")
    begun_s = time.monotonic()
    rate = client.count_frames(seconds)
    ours.send("end")
    share = ours.recv() / (time.monotonic() - begun_s)
    client.close()
    process.join()
    return rate, share


def _milliseconds_of_parts(record: Recorder) -> None:
    """Where a frame's time goes, and what the sensor model's own noise would cost."""
    bench = PracticeBench(load_bench(CONFIG), height_mm=lambda: 200.0, address=ADDRESS)
    request = FrameRequest(
        acquisition=1, index=0, exposure_us=9000.0, gain_db=0.0, black_level_dn=64.0
    )
    level_dn = bench.source.levels_dn(request)
    electrons = bench.truth.sensor.electrons(
        bench.truth.irradiance("edge", 0.0, bench.pose), 9000.0
    )
    rng = np.random.default_rng(0)
    parts: dict[str, Callable[[], object]] = {
        "noise, 16 bits and a table per pixel": lambda: bench.source.levels_dn(request),
        "peer: Sensor.expose (Poisson and normal)": lambda: bench.truth.sensor.expose(
            electrons, 0.0, "Mono12", rng
        ),
        "Mono12 to bytes": lambda: wire_bytes(level_dn, PIXEL_LAYOUTS["Mono12"]),
        "Mono12Packed to bytes": lambda: wire_bytes(level_dn, PIXEL_LAYOUTS["Mono12Packed"]),
    }
    for name, work in parts.items():
        started_s = time.process_time()
        for _ in range(REPEATS):
            work()
        record.time(name, (time.process_time() - started_s) / REPEATS)


@benchmark("numpy", "numba")
def main(record: Recorder) -> None:
    _milliseconds_of_parts(record)
    seconds = record.pick(SECONDS, 2.0)
    for packet_size_bytes in (1500, 8228):
        rate, share = _measure(packet_size_bytes, 64, seconds)
        _, peer = _measure(packet_size_bytes, 1, seconds)
        record.figure(
            f"serve 67.5 frames/s in packets of {packet_size_bytes} bytes",
            100 * share,
            "% of a core",
            "one call for each packet",
            100 * peer,
        )
        record.say(f"served {rate:.1f} frames/s")
