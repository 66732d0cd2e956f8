"""The vendor's own client judges the Zaber emulator, on a pseudo-terminal."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

zaber_motion = pytest.importorskip("zaber_motion")

from zaber_motion import CommandFailedException, Units  # noqa: E402
from zaber_motion.ascii import Axis, Connection  # noqa: E402

from acquisition.stages.zaber import checksum  # noqa: E402
from hil_mocks.stages._plant import StagePlant  # noqa: E402
from hil_mocks.stages._serial_stage import LineFaults, PtyPort, SerialLine  # noqa: E402
from hil_mocks.stages._zaber import ZaberFirmware  # noqa: E402
from tests.hil_mocks.stage_rigs import MICROSTEP_UM  # noqa: E402

FASTER = 20.0
MM = 1000 / MICROSTEP_UM


class ListeningFirmware(ZaberFirmware):
    """Keeps what the host sent."""

    heard = b""

    def receive(self, data: bytes) -> None:
        self.heard += data
        super().receive(data)


@dataclass(kw_only=True)
class Bench:
    connection: Connection
    axis: Axis
    plant: StagePlant
    firmware: ListeningFirmware
    port: PtyPort


@pytest.fixture
def bench() -> Iterator[Bench]:
    plant = StagePlant(start_mm=30.0)
    firmware = ListeningFirmware(plant, microstep_um=MICROSTEP_UM)
    start_s = time.monotonic()
    line = SerialLine(firmware)
    with PtyPort(line, clock=lambda: (time.monotonic() - start_s) * FASTER) as port:
        connection = Connection.open_serial_port(port.path)
        try:
            connection.checksum_enabled = True
            yield Bench(
                connection=connection,
                axis=connection.get_device(1).get_axis(1),
                plant=plant,
                firmware=firmware,
                port=port,
            )
        finally:
            connection.close()


def test_it_homes_and_moves(bench: Bench) -> None:
    assert bench.axis.warnings.get_flags() == {"WR"}
    bench.axis.home()
    assert bench.axis.warnings.get_flags() == set()
    assert bench.plant.true_height_mm == pytest.approx(5.0, abs=0.01)
    bench.axis.move_absolute(round(10 * MM), Units.NATIVE)
    assert bench.axis.get_position(Units.NATIVE) == round(10 * MM)
    assert bench.plant.true_height_mm == pytest.approx(15.0, abs=0.01)


def test_it_stops_in_mid_move(bench: Bench) -> None:
    bench.axis.home()
    bench.axis.move_absolute(round(300 * MM), Units.NATIVE, wait_until_idle=False)
    assert bench.axis.is_busy()
    bench.axis.stop()
    assert not bench.axis.is_busy()
    assert 5.0 < bench.plant.true_height_mm < 305.0
    counted_mm = bench.axis.get_position(Units.NATIVE) / MM
    assert bench.plant.true_height_mm == pytest.approx(5.0 + counted_mm, abs=0.01)


def test_it_rejects_what_is_out_of_range(bench: Bench) -> None:
    with pytest.raises(CommandFailedException) as caught:
        bench.axis.move_absolute(-5, Units.NATIVE)
    assert caught.value.details.response_data == "BADDATA"
    with pytest.raises(CommandFailedException) as caught:
        bench.axis.generic_command("dance")
    assert caught.value.details.response_data == "BADCOMMAND"


def test_the_client_accepts_replies_with_checksums(bench: Bench) -> None:
    bench.connection.generic_command("set comm.checksum 1", 1)
    assert bench.connection.generic_command("get comm.checksum", 1).data == "1"


def test_the_client_refuses_replies_with_bad_checksums(bench: Bench) -> None:
    bench.connection.generic_command("set comm.checksum 1", 1)
    with bench.port.locked():
        bench.port.line.faults = LineFaults(swap=b"08")
    with pytest.raises(zaber_motion.MotionLibException):
        bench.connection.generic_command("get resolution", 1, timeout=300)


def test_the_checksum_of_our_driver_is_that_of_the_client(bench: Bench) -> None:
    with bench.port.locked():
        bench.firmware.heard = b""
    bench.axis.generic_command("get maxspeed")
    with bench.port.locked():
        body, sent = bench.firmware.heard.strip()[1:].split(b":")
    assert body.endswith(b"get maxspeed")
    assert checksum(body.decode("ascii")) == int(sent, 16)


@pytest.mark.slow
def test_the_client_detects_it(bench: Bench) -> None:
    # Without identification: that would ask a data base on the internet.
    (device,) = bench.connection.detect_devices(identify_devices=False)
    assert device.device_address == 1
