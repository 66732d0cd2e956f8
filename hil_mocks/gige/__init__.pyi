from .bootstrap import BootstrapAddress as BootstrapAddress, maker_identity as maker_identity
from .device import (
    ETHERNET_MTU_BYTES as ETHERNET_MTU_BYTES,
    GigeDevice as GigeDevice,
    checked_loopback_address as checked_loopback_address,
)
from .faults import GigeFaults as GigeFaults
from .feature import Maker as Maker
from .features import MAKERS as MAKERS, features_of as features_of
from .frame_source import (
    BenchFrameSource as BenchFrameSource,
    FrameRequest as FrameRequest,
    FrameSource as FrameSource,
)
from .gvcp import (
    GVCP_PORT as GVCP_PORT,
    CommandCode as CommandCode,
    RegisterWrite as RegisterWrite,
)
from .gvsp import PacketFormat as PacketFormat
from .pixels import PIXEL_LAYOUTS as PIXEL_LAYOUTS, wire_bytes as wire_bytes
