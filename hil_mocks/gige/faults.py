"""Faults of the simulated GigE camera, on demand and while it runs."""

from dataclasses import dataclass, fields

import numpy as np

RATES = ("packet_loss_rate", "duplicate_rate", "reorder_rate")


@dataclass(frozen=True, slots=True, kw_only=True)
class GigeFaults:
    """Faults from now on; a restart and a loss of control are methods of the device.

    Parameters
    ----------
    seed
        Seed of the three rates.
    packet_loss_rate
        Fraction of the stream's packets that do not arrive; resent packets can be lost too.
    duplicate_rate, reorder_rate
        Fraction of the packets that come twice, or after the one that follows them.
    resend_disabled
        The device does not support the command for resending packets.
    is_stalled
        No frame is taken.
    is_dead
        Nothing answers and nothing is sent: no power, or the cable is pulled.
    heartbeat_lost
        Commands no longer keep control alive: it expires after the heartbeat timeout.
    corrupt_leader
        Leaders have a payload type that does not exist.
    missing_rows
        The image has this many rows fewer than was set.
    refused_registers
        Names of features whose registers refuse every write.
    slow_writes_s
        Delay before a write is answered; the device sends a pending acknowledge if it may.
    temperature_present
        The description has a DeviceTemperature, unlike a Manta's.
    exposure_delay_frames
        Frames have the exposure that was set so many frames earlier.
    gain_delay_frames
        Frames have the gain that was set so many frames earlier.
    """

    seed: int = 0
    packet_loss_rate: float = 0.0
    duplicate_rate: float = 0.0
    reorder_rate: float = 0.0
    resend_disabled: bool = False
    is_stalled: bool = False
    is_dead: bool = False
    heartbeat_lost: bool = False
    corrupt_leader: bool = False
    missing_rows: int = 0
    refused_registers: frozenset[str] = frozenset()
    slow_writes_s: float = 0.0
    temperature_present: bool = False
    exposure_delay_frames: int = 0
    gain_delay_frames: int = 0

    def __post_init__(self) -> None:
        for name in RATES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be from 0 to 1, got {getattr(self, name)}")
        for name in (
            "seed",
            "missing_rows",
            "slow_writes_s",
            "exposure_delay_frames",
            "gain_delay_frames",
        ):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")

    @property
    def disturbs_packets(self) -> bool:
        """Whether the packets of a block do not simply arrive in order."""
        return any(getattr(self, name) > 0 for name in RATES)

    def order_of_arrival(self, packet_count: int, draw: int) -> list[int]:
        """Return which of the packets 0 to ``packet_count - 1`` arrive, in that order.

        Parameters
        ----------
        packet_count
            Number of packets sent.
        draw
            Number of the draw: the same seed and draw give the same order.
        """
        rng = np.random.default_rng([self.seed, draw])
        lost, twice, late = (rng.random(packet_count) < getattr(self, name) for name in RATES)
        positions = np.arange(packet_count, dtype=np.float64)
        positions[late] += 1.5
        arriving = np.repeat(np.flatnonzero(~lost), np.where(twice[~lost], 2, 1))
        return [int(packet) for packet in arriving[np.argsort(positions[arriving], kind="stable")]]

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of the faults."""
        return tuple(field.name for field in fields(cls))
