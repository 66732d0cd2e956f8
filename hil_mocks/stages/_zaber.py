"""A Zaber firmware emulator, written from the published protocol.

It shares no code with the driver; it is checked against the vendor's own client.

References
----------
Zaber ASCII Protocol Manual, firmware 7: "Message Format", "Commands", "Settings",
"Warning Flags".
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from hil_mocks.stages._plant import StagePlant, StepperAxis

STEP_S = 0.004
SPEED_UNIT = 1.6384
"""``maxspeed`` is in microsteps per second times this."""

HOMING_SPEED_MM_PER_S = 20.0
LOCATING_SPEED_MM_PER_S = 1.0
BACK_OFF_MM = 1.0
STALL_MM = 0.2
ACCELERATION_MM_PER_S2 = 200.0

_NUMBER = re.compile(r"\d{1,10}", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberFaults:
    """Faults of the controller from now on."""

    hangs: bool = False  # neither obeys nor answers; a running move continues
    rejects: str | None = None  # reason for which moves are, such as ``DRIVERDISABLED``
    stops_short_mm: float = 0.0  # moves end before their target
    never_idle: bool = False  # replies never show the end of a move, which cannot be stopped
    shows_flag: str | None = None  # in addition to its own
    alerts: bool = False  # sends alerts and info lines between its replies


class ZaberFirmware:
    """A controller driven by bytes and time; moves a plant; homes to the lower switch.

    ``address`` is that in the chain; the axis travels upwards from the switch.
    """

    def __init__(
        self,
        plant: StagePlant,
        *,
        microstep_um: float = 0.49609375,
        address: int = 1,
        travel_mm: float = 400.0,
    ) -> None:
        self.plant = plant
        self.commands_received: list[str] = []
        self.axis = StepperAxis(
            plant,
            steps_per_mm=1000 / microstep_um,
            acceleration_mm_per_s2=ACCELERATION_MM_PER_S2,
        )
        self._microstep_mm = microstep_um / 1000
        self._faults = ZaberFaults()
        self._address = address
        self._now_s = 0.0
        self._input = b""
        self._output: list[bytes] = []
        self._flags: set[str] = {"WR"}
        self._homing: list[str] = []
        self._slipped_mm = 0.0
        self._settings: dict[str, float | str] = {
            "comm.address": address,
            "comm.alert": 0,
            "comm.checksum": 0,
            "comm.protocol": 2,
            "comm.rs232.baud": 115200,
            "device.id": 50081,
            "system.serial": 12345,
            "system.axiscount": 1,
            "version": "7.38",
            "version.build": 17000,
            "peripheral.id": 43211,
            "resolution": 64,
            "limit.min": 0,
            "limit.max": round(travel_mm / self._microstep_mm),
            "maxspeed": round(20.0 / self._microstep_mm * SPEED_UNIT),
            "accel": 205,
        }

    @property
    def faults(self) -> ZaberFaults:
        """Its faults."""
        return self._faults

    @faults.setter
    def faults(self, faults: ZaberFaults) -> None:
        self._faults = faults
        self.axis.stops_short_mm = faults.stops_short_mm
        self.axis.ignores_brake = faults.never_idle

    @property
    def flags(self) -> list[str]:
        """Warning flags, the most serious first."""
        shown = self._flags | ({self._faults.shows_flag} if self._faults.shows_flag else set())
        return sorted(shown, key=lambda flag: ("FWN".index(flag[0]), flag))

    def power_cycle(self) -> None:
        """Restart, as after a brown-out; position and reference are lost."""
        self.axis.halt()
        self.axis.count_from(0.0)
        self._homing.clear()
        self._input = b""
        self._output.clear()
        self._flags = {"WR"}

    def receive(self, data: bytes) -> None:
        """See `Firmware.receive`."""
        if self._faults.hangs:
            return
        self._input += data
        while b"\n" in self._input or b"\r" in self._input:
            self._input = self._input.replace(b"\r", b"\n")
            line, _, self._input = self._input.partition(b"\n")
            if line.strip():
                self._take_line(line)

    def advance(self, now_s: float) -> None:
        """See `Firmware.advance`."""
        while self._now_s < now_s:
            duration_s = min(STEP_S, now_s - self._now_s)
            if not self.axis.is_moving:
                duration_s = now_s - self._now_s
                self.axis.rest(duration_s)
            self._now_s += duration_s
            self.plant.now_s = self._now_s
            self.axis.advance(duration_s)
            self._watch_stall()
            if self._homing:
                self._step_homing()

    def take_lines(self) -> list[bytes]:
        """See `Firmware.take_lines`."""
        lines, self._output = self._output, []
        return lines

    def _watch_stall(self) -> None:
        if self.plant.slipped_mm - self._slipped_mm > STALL_MM:
            self._slipped_mm = self.plant.slipped_mm
            self.axis.halt()
            self._homing.clear()
            self._flags |= {"FS", "WR"}
            self._alert()

    def _step_homing(self) -> None:
        phase = self._homing[0]
        is_search = phase != "back off"
        if is_search and self.plant.is_low_pressed:
            self.axis.halt()
        elif self.axis.is_moving:
            return
        elif is_search:
            self._homing.clear()
            self._flags |= {"FE"}
            return
        self._homing.pop(0)
        if not self._homing:
            self.axis.count_from(0.0)
            self._flags -= {"WR"}
            self._alert()
            return
        way_mm, speed = {
            "back off": (BACK_OFF_MM, HOMING_SPEED_MM_PER_S),
            "locate": (-5 * BACK_OFF_MM, LOCATING_SPEED_MM_PER_S),
        }[self._homing[0]]
        self.axis.go(self.axis.counted_mm + way_mm, speed)

    def _take_line(self, line: bytes) -> None:
        text = line.decode("latin-1").strip()
        if not text.startswith("/"):
            return
        body = text[1:]
        if len(body) > 3 and body[-3] == ":":
            body, sent = body[:-3], body[-2:]
            total = sum(ord(char) for char in body)
            try:
                is_right = (total + int(sent, 16)) % 256 == 0
            except ValueError:
                is_right = False
            if not is_right:
                return  # the manual: a command with a wrong checksum is ignored
        words = body.split()
        numbers: list[int] = []
        message_id = ""
        while words and len(numbers) < 2 and _NUMBER.fullmatch(words[0]):
            numbers.append(int(words.pop(0)))
        if len(numbers) == 2 and words and (_NUMBER.fullmatch(words[0]) or words[0] == "--"):
            message_id = words.pop(0)
        device, axis = (*numbers, 0, 0)[:2]
        if device not in (0, self._address):
            return
        self.commands_received.append(" ".join(words))
        if axis > 1:
            self._reply(axis, message_id, "RJ", "BADAXIS")
            return
        result, data = self._execute(words, axis)
        self._reply(axis, message_id, result, data)
        if self._faults.alerts:
            self._alert()
            self._send("#", f"{self._address:02d} 0 {message_id or '00'} a remark".strip())

    def _execute(self, words: list[str], axis: int) -> tuple[str, str]:
        if not words:
            return "OK", "0"
        handlers: dict[str, Callable[[list[str]], tuple[str, str]]] = {
            "home": self._home,
            "move": self._move,
            "stop": self._stop,
            "estop": self._emergency_stop,
            "get": self._get,
            "set": self._set,
            "warnings": self._warnings,
            "driver": self._driver,
        }
        handler = handlers.get(words[0])
        return handler(words[1:]) if handler else ("RJ", "BADCOMMAND")

    def _home(self, words: list[str]) -> tuple[str, str]:
        if self._faults.rejects:
            return "RJ", self._faults.rejects
        self._flags -= {"FS", "FE", "NI"}
        self._homing = ["search", "back off", "locate"]
        travel_mm = float(self._settings["limit.max"]) * self._microstep_mm
        self.axis.go(self.axis.counted_mm - 1.5 * travel_mm, HOMING_SPEED_MM_PER_S)
        return "OK", "0"

    def _move(self, words: list[str]) -> tuple[str, str]:
        if self._faults.rejects:
            return "RJ", self._faults.rejects
        kind, *values = words or [""]
        low, high = float(self._settings["limit.min"]), float(self._settings["limit.max"])
        try:
            value = int(values[0]) if values else 0
        except ValueError:
            return "RJ", "BADDATA"
        targets = {"abs": value, "rel": self.axis.steps + value, "min": low, "max": high}
        if kind not in targets or (kind in ("abs", "rel") and not values):
            return "RJ", "BADCOMMAND"
        if not low <= targets[kind] <= high:
            return "RJ", "BADDATA"
        self._flags -= {"NI"} | {flag for flag in self._flags if flag == "FS"}
        speed = float(self._settings["maxspeed"]) / SPEED_UNIT * self._microstep_mm
        self._homing.clear()
        self.axis.go(targets[kind] * self._microstep_mm, speed)
        return "OK", "0"

    def _stop(self, words: list[str]) -> tuple[str, str]:
        if self.axis.is_moving:
            self._flags |= {"NI"}
        self._homing.clear()
        self.axis.brake()
        return "OK", "0"

    def _emergency_stop(self, words: list[str]) -> tuple[str, str]:
        if self.axis.is_moving:
            self._flags |= {"NI"}
        self._homing.clear()
        self.axis.halt()
        return "OK", "0"

    def _get(self, words: list[str]) -> tuple[str, str]:
        if words == ["pos"]:
            return "OK", str(self.axis.steps)
        value = self._settings.get(words[0]) if len(words) == 1 else None
        return ("RJ", "BADCOMMAND") if value is None else ("OK", str(value))

    def _set(self, words: list[str]) -> tuple[str, str]:
        read_only = ("device.id", "system.serial", "version", "system.axiscount")
        if len(words) != 2 or words[0] not in self._settings or words[0] in read_only:
            return "RJ", "BADCOMMAND"
        try:
            self._settings[words[0]] = int(words[1])
        except ValueError:
            return "RJ", "BADDATA"
        return "OK", "0"

    def _warnings(self, words: list[str]) -> tuple[str, str]:
        flags = self.flags
        if words == ["clear"]:
            self._flags = {flag for flag in self._flags if flag in ("WR", "WH")}
        return "OK", " ".join([f"{len(flags):02d}", *flags])

    def _driver(self, words: list[str]) -> tuple[str, str]:
        if words not in (["enable"], ["disable"]):
            return "RJ", "BADCOMMAND"
        if words == ["enable"]:
            self._flags -= {"FO", "FD"}
            self._faults = ZaberFaults()
        else:
            self.axis.halt()
            self._flags |= {"FO"}
        return "OK", "0"

    def _state(self) -> str:
        is_busy = self.axis.is_moving or bool(self._homing) or self._faults.never_idle
        flags = self.flags
        return f"{'BUSY' if is_busy else 'IDLE'} {flags[0] if flags else '--'}"

    def _reply(self, axis: int, message_id: str, result: str, data: str) -> None:
        numbers = f"{self._address:02d} {axis}" + (f" {message_id}" if message_id else "")
        self._send("@", f"{numbers} {result} {self._state()} {data}")

    def _alert(self) -> None:
        if self._settings["comm.alert"] or self._faults.alerts:
            self._send("!", f"{self._address:02d} 1 {self._state()}")

    def _send(self, kind: str, body: str) -> None:
        end = ""
        if self._settings["comm.checksum"]:
            end = f":{(256 - sum(body.encode('ascii')) % 256) % 256:02X}"
        self._output.append(f"{kind}{body}{end}\r\n".encode("ascii"))
