"""The largest stream packet that reaches this computer from a GigE Vision camera, by trial.

Done over the bootstrap registers, which every camera has: Aravis' own negotiation gives up where
the camera's description does not show ``GevSCPSFireTestPacket`` as a command (Aravis 0.8.26).

References
----------
AIA, GigE Vision, version 2.0 (2011), section "Bootstrap registers", stream channel 0.
"""

import socket
import time

from acquisition.aravis.device import OpenedDevice
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.features import CameraFeatures, whole
from acquisition.aravis.route import route_to
from acquisition.errors import CameraFeatureError

PACKET_SIZE = "GevSCPSPacketSize"

SAFE_PACKET_BYTES = 1500
"""Packet size that Ethernet carries without any configuration."""

PORT_REGISTER = 0x0D00
SIZE_REGISTER = 0x0D04
ADDRESS_REGISTER = 0x0D18

FIRE_TEST_PACKET = 0x8000_0000
DO_NOT_FRAGMENT = 0x4000_0000
SIZE_MASK = 0xFFFF

IP_AND_UDP_HEADER_BYTES = 28
USUAL_SIZES = (16000, 9000, 8228, 8000, 6000, 4000, 3000, 2000, SAFE_PACKET_BYTES, 1400, 576)
"""Sizes for jumbo frames and tunnels, and the smallest that every network carries."""

TRIES = 3
WAIT_S = 0.02


def set_packet_size(
    opened: OpenedDevice, features: CameraFeatures, packet_size_bytes: int | None
) -> tuple[str, ...]:
    """Set a packet size, or the largest that gets through; return warnings.

    Raises
    ------
    CameraFeatureError
        If the camera does not keep it.
    """
    warnings: tuple[str, ...] = ()
    with translated_errors(opened.library, PACKET_SIZE):
        # Making a stream would negotiate, unasked. A Manta's packet size at power-up is above
        # its own maximum; Aravis 0.8.26 then ends the process with an assertion.
        opened.camera.gv_set_packet_size_adjustment(opened.library.api.GvPacketSizeAdjustment.NEVER)
        if packet_size_bytes is None:
            bounds = features.bounds(PACKET_SIZE)
            route = route_to(opened.name)
            packet_size_bytes = largest_packet(
                opened,
                own_address=route.own_address,
                mtu_bytes=route.mtu_bytes,
                low=whole(bounds.low, PACKET_SIZE),
                high=whole(bounds.high, PACKET_SIZE),
                step=max(1, round(features.step(PACKET_SIZE))),
            )
        if packet_size_bytes is None:
            packet_size_bytes = SAFE_PACKET_BYTES
            warnings = (
                "no test packet arrived from the camera: a firewall blocks its stream, or it "
                f"sends none; the packet size is set to {SAFE_PACKET_BYTES} bytes",
            )
        opened.camera.gv_set_packet_size(packet_size_bytes)
        found = int(opened.camera.gv_get_packet_size())
    if found != packet_size_bytes:
        raise CameraFeatureError(
            f"the camera does not keep {PACKET_SIZE}: set to {packet_size_bytes}, it reads {found}",
            feature=PACKET_SIZE,
        )
    return warnings


def largest_packet(
    opened: OpenedDevice, *, own_address: str, mtu_bytes: int, low: int, high: int, step: int
) -> int | None:
    """Return the largest packet size that arrives whole, or None if no test packet does.

    The camera's own packet size is restored afterwards.

    Parameters
    ----------
    own_address
        Address of the interface that leads to the camera.
    mtu_bytes
        Largest packet that this interface carries.
    low, high, step
        Packet sizes that the camera accepts, in bytes.
    """
    most = min(mtu_bytes, high)
    sizes = {low + (size - low) // step * step for size in (most, *USUAL_SIZES) if low <= size}
    sizes = {size for size in sizes if size <= most}
    with (
        translated_errors(opened.library, "GevSCPSPacketSize"),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind((own_address, 0))
        before = opened.device.read_register(SIZE_REGISTER)
        opened.device.write_register(
            ADDRESS_REGISTER, int.from_bytes(socket.inet_aton(own_address), "big")
        )
        opened.device.write_register(PORT_REGISTER, receiver.getsockname()[1])
        try:
            # The sizes that always get through reveal a camera that sends no test packets at all;
            # it is not asked for the others.
            certain = sorted(size for size in sizes if size <= SAFE_PACKET_BYTES)[::-1]
            jumbo = sorted(sizes - set(certain))[::-1]
            arrived = next((s for s in certain if _arrives(opened, receiver, s)), None)
            if arrived is None or arrived < certain[0]:
                return arrived
            return next((s for s in jumbo if _arrives(opened, receiver, s)), arrived)
        finally:
            opened.device.write_register(PORT_REGISTER, 0)
            opened.device.write_register(SIZE_REGISTER, before & ~FIRE_TEST_PACKET)


def _arrives(opened: OpenedDevice, receiver: socket.socket, size: int) -> bool:
    for _ in range(TRIES):
        opened.device.write_register(SIZE_REGISTER, FIRE_TEST_PACKET | DO_NOT_FRAGMENT | size)
        deadline_s = time.monotonic() + WAIT_S
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            receiver.settimeout(remaining_s)
            try:
                datagram, sender = receiver.recvfrom(SIZE_MASK)
            except TimeoutError:
                break
            # A late packet of another trial, or from another sender, does not count.
            if sender[0] == opened.name and len(datagram) == size - IP_AND_UDP_HEADER_BYTES:
                return True
    return False
