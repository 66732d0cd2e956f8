from ._device import (
    ETHERNET_MTU_BYTES as ETHERNET_MTU_BYTES,
    GigeDevice as GigeDevice,
    checked_loopback_address as checked_loopback_address,
)
from ._features import MAKERS as MAKERS, Maker as Maker, features_of as features_of
from ._registers import BootstrapAddress as BootstrapAddress, maker_identity as maker_identity
from ._settings import (
    BenchFrameSource as BenchFrameSource,
    FrameRequest as FrameRequest,
    FrameSource as FrameSource,
    GigeFaults as GigeFaults,
)
from ._wire import (
    GVCP_PORT as GVCP_PORT,
    PIXEL_LAYOUTS as PIXEL_LAYOUTS,
    CommandCode as CommandCode,
    PacketFormat as PacketFormat,
    RegisterWrite as RegisterWrite,
    wire_bytes as wire_bytes,
)
