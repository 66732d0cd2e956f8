from .bootstrap import BootstrapAddress as BootstrapAddress, Identity as Identity
from .device import (
    ETHERNET_MTU_BYTES as ETHERNET_MTU_BYTES,
    GigeDevice as GigeDevice,
    checked_loopback_address as checked_loopback_address,
)
from .faults import GigeFaults as GigeFaults
from .features import features_of as features_of
from .frame_source import (
    BenchFrameSource as BenchFrameSource,
    FrameRequest as FrameRequest,
    FrameSource as FrameSource,
)
from .gvcp import (
    GVCP_PORT as GVCP_PORT,
    CommandCode as CommandCode,
    RegisterWrite as RegisterWrite,
    encode_command as encode_command,
    encode_write_memory as encode_write_memory,
    encode_write_registers as encode_write_registers,
)
from .gvsp import PacketFormat as PacketFormat, parse_packet as parse_packet
from .pixels import PIXEL_LAYOUTS as PIXEL_LAYOUTS, wire_bytes as wire_bytes

__all__ = [
    "ETHERNET_MTU_BYTES",
    "GVCP_PORT",
    "PIXEL_LAYOUTS",
    "BenchFrameSource",
    "BootstrapAddress",
    "CommandCode",
    "FrameRequest",
    "FrameSource",
    "GigeDevice",
    "GigeFaults",
    "Identity",
    "PacketFormat",
    "RegisterWrite",
    "checked_loopback_address",
    "encode_command",
    "encode_write_memory",
    "encode_write_registers",
    "features_of",
    "parse_packet",
    "wire_bytes",
]
