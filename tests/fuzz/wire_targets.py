"""Bytes on wires: GVCP and GVSP datagrams, serial lines into the drivers and the emulators."""

from collections.abc import Callable
from functools import cache

from hypothesis import strategies as st

from acquisition.aravis._description import DescriptionError, require_sound_description
from acquisition.aravis._network import _unpack
from acquisition.aravis._stream import _decode_pixels
from acquisition.errors import CameraDescriptionError, DeviceError
from hil_mocks.gige._device import ControlChannel
from hil_mocks.gige._features import features_of
from hil_mocks.gige._registers import BootstrapAddress, Identity, RegisterMap
from hil_mocks.gige._settings import CameraState, GigeFaults
from hil_mocks.gige._wire import CommandCode, GvcpError, RegisterWrite, ResendRequest
from hil_mocks.stages._grbl import GrblFirmware
from hil_mocks.stages._plant import StagePlant
from hil_mocks.stages._serial_stage import LineFaults, SerialLine
from hil_mocks.stages._zaber import ZaberFirmware
from tests.acquisition.aravis.description_texts import simulated, with_nodes
from tests.acquisition.aravis.test_network import packed
from tests.fuzz.damage import damaged_bytes
from tests.fuzz.target import FuzzTarget
from tests.hil_mocks.gige_wire import (
    encode_command,
    encode_read_memory,
    encode_read_registers,
    encode_resend_request,
    encode_write_memory,
    encode_write_registers,
    parse_acknowledge,
)
from tests.hil_mocks.stage_rigs import GrblRig, ZaberRig, grbl_rig, zaber_rig

PEER = ("127.0.0.1", 5000)
CONTROL = [RegisterWrite(address=BootstrapAddress.CONTROL_PRIVILEGE, value=2)]


@cache
def feature_addresses() -> tuple[int, ...]:
    return tuple(feature.address for feature in features_of(None, has_temperature=True))


def commands() -> tuple[bytes, ...]:
    """One sound datagram of each kind, and writes to every feature."""
    writes = [
        encode_write_registers([RegisterWrite(address=address, value=1)])
        for address in (*feature_addresses(), BootstrapAddress.STREAM_PORT)
    ]
    payloads = [
        (CommandCode.DISCOVERY, b""),
        (CommandCode.READREG, encode_read_registers([0, BootstrapAddress.CONTROL_PRIVILEGE])),
        (CommandCode.READMEM, encode_read_memory(0, 512)),
        (CommandCode.WRITEMEM, encode_write_memory(feature_addresses()[0], bytes(8))),
        (
            CommandCode.PACKETRESEND,
            encode_resend_request(ResendRequest(channel=0, block_id=1, first=0, last=9)),
        ),
        *((CommandCode.WRITEREG, payload) for payload in writes),
    ]
    return tuple(encode_command(code, 7, payload) for code, payload in payloads)


def control_camera(datagram: bytes) -> None:
    """Give a datagram to a camera under control; whatever it does, it answers the next one.

    The camera's control channel alone: what it streams, and where to, stays on paper.
    """
    features = features_of(None, has_temperature=True)
    state = CameraState(features, shape=(64, 96), black_level_dn=64.0)
    registers = RegisterMap(
        Identity(),
        "127.0.0.1",
        features,
        state,
        commands=dict.fromkeys(
            ("AcquisitionStart", "AcquisitionStop", "TriggerSoftware", "TestEventGenerate"),
            lambda: None,
        ),
        fire_test_packet=lambda: None,
    )
    registers.describe(features)
    registers.power_up()
    channel = ControlChannel(registers, GigeFaults, resend=lambda _: None, end_stream=lambda: None)
    take_control = encode_command(CommandCode.WRITEREG, 1, encode_write_registers(CONTROL))
    assert channel.answer(take_control, PEER) is not None
    answer = channel.answer(datagram, PEER)
    if answer is not None:
        parse_acknowledge(answer)
    asked = encode_command(CommandCode.READREG, 9, encode_read_registers([0]))
    again = channel.answer(asked, PEER)
    assert again is not None
    assert parse_acknowledge(again).request_id == 9
    for feature in features:
        state.value(feature.name)


def disturbed(data: bytes) -> LineFaults:
    """Bytes as a fault of the line: the first says which, the others come over it."""
    rest = data[1:]
    return (
        LineFaults(before=rest),
        LineFaults(inside=rest),
        LineFaults(after=rest),
        LineFaults(swap=rest[:2].ljust(2, b"0"), count=data[0]),
        LineFaults(cut=bool(data[0] & 8), merge=True, before=rest, count=3),
        LineFaults(chatter=rest + b"\n"),
    )[data[0] % 6]


def drive(rig: GrblRig | ZaberRig, data: bytes) -> None:
    """Connect, then home, move, ask and stop over a line that is disturbed from some step on.

    Every step may fail with an error of its own, and the next one is tried all the same.
    """
    stage = rig.stage
    steps: tuple[Callable[[], object], ...] = (
        rig.axis.connect,
        lambda: stage.home(60),
        lambda: stage.move_to(120.0, 20),
        stage.position_mm,
        lambda: stage.state,
        stage.stop,
        stage.clear_alarm,
    )
    failed: DeviceError | None = None
    for place, step in enumerate(steps):
        if place == data[0] % 4:
            rig.line.faults = disturbed(data)
        try:
            step()
        except DeviceError as error:
            failed = error
    if failed is not None:
        raise failed


def into_emulator(firmware: GrblFirmware | ZaberFirmware, data: bytes) -> None:
    """Give bytes to a controller in two pieces, and let time pass."""
    line = SerialLine(firmware)
    half = len(data) // 2
    for piece, now_s in ((data[:half], 0.5), (data[half:], 3.0), (b"?\n/\n", 10.0)):
        line.send(piece)
        line.take(now_s)


def into_grbl(data: bytes) -> None:
    into_emulator(GrblFirmware(StagePlant(start_mm=150.0)), data)


def into_zaber(data: bytes) -> None:
    into_emulator(ZaberFirmware(StagePlant(start_mm=150.0)), data)


def decode_frame(data: bytes) -> None:
    _decode_pixels(data[1:], ("Mono8", "Mono12", "Mono12Packed")[data[0] % 3], (4, 6))


ODD_NODES = (
    '<IntSwissKnife Name="A"><pVariable Name="V">Width</pVariable><Constant Name="C">-1</Constant>'
    '<Expression Name="X">V % 7</Expression><Formula>(X ** 2) / C ? ~V : abs(V)</Formula>'
    '</IntSwissKnife><IntReg Name="B"><pAddress>A</pAddress><pIndex pOffset="A">A</pIndex>'
    "<Length>4</Length><pPort>Device</pPort></IntReg>"
)

GRBL_LINES = (
    b"$X\n$J=G90G21Z-10.000F600\n?\n$$\n$H\n",
    b"\x18\x85$I\n$130=400\n$13=1\nG0Z1\n",
    b"ok\r\n<Idle|MPos:0.000,0.000,-98.000|FS:0,0>\r\nALARM:1\r\nGrbl 1.1h ['$' for help]\r\n",
    b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\nerror:15\r\n$13=1\r\n",
)
ZABER_LINES = (
    b"/1 1 07 home\n/1 1 08 move abs 40000\n/1 1 09 get pos\n",
    b"/1 1 10 set limit.max 1e400\n/1 1 11 set maxspeed nan\n/1 1 estop\n/1 1 warnings\n",
    b"@01 1 07 OK IDLE -- 0:21\r\n!01 1 IDLE --\r\n#01 1 data\r\n",
    b"@01 1 00 RJ IDLE WR BADDATA\r\n@01 1 01 OK BUSY FS nan\r\n",
)


def at_least_one_byte(samples: tuple[bytes, ...]) -> st.SearchStrategy[bytes]:
    return st.builds(
        lambda first, rest: first + rest, st.binary(min_size=1, max_size=1), damaged_bytes(samples)
    )


DESCRIPTIONS = damaged_bytes((simulated(), with_nodes(ODD_NODES)))
PACKED = damaged_bytes((packed(simulated()),))
PIXELS = at_least_one_byte((bytes(48),))
GRBL, ZABER = damaged_bytes(GRBL_LINES), damaged_bytes(ZABER_LINES)

WIRE_TARGETS = (
    FuzzTarget(
        "GVCP into the camera", damaged_bytes(commands()), control_camera, (GvcpError,), 300
    ),
    FuzzTarget(
        "description of a camera",
        DESCRIPTIONS,
        lambda data: require_sound_description(data, "the camera"),
        (CameraDescriptionError,),
    ),
    FuzzTarget("packed description of a camera", PACKED, _unpack, (DescriptionError,), 200),
    FuzzTarget("pixels of a frame", PIXELS, decode_frame, (DeviceError, ValueError)),
    FuzzTarget(
        "serial line into the Grbl driver",
        at_least_one_byte(GRBL_LINES),
        lambda data: drive(grbl_rig(connect=False, boots=False), data),
        (DeviceError,),
        25,
    ),
    FuzzTarget(
        "serial line into the Zaber driver",
        at_least_one_byte(ZABER_LINES),
        lambda data: drive(zaber_rig(connect=False), data),
        (DeviceError,),
        25,
    ),
    FuzzTarget("serial line into the Grbl emulator", GRBL, into_grbl, (), 200),
    FuzzTarget("serial line into the Zaber emulator", ZABER, into_zaber, (), 200),
)
