"""Whether a device can be used, and what the operator should do if it cannot."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceStatus:
    """``text`` says what is wrong, ``remedy`` what to do; both are empty when ready."""

    state: Literal["opening", "ready", "lost"]
    text: str = ""
    remedy: str = ""

    @property
    def is_ready(self) -> bool:
        """Whether the device responds."""
        return self.state == "ready"
