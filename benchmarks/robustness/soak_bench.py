"""The simulated bench of the soak, as a process of its own that goes wrong on command.

What ``standoff mock --stage-protocol grbl`` serves, with its lines on standard input, and three
more for the stage: ``alarm``, ``unplug`` and ``plug-in``. A link leads to the stage's port, as
those in ``/dev/serial/by-id`` do.
"""

import sys
from collections.abc import Callable
from pathlib import Path

from acquisition.bench import load_bench
from hil_mocks.practice_bench import PracticeBench, PracticeConsole
from hil_mocks.stages import GrblFirmware, LineFaults, SerialStage
from standoff.shipped_configs import shipped_config

SENSOR = {"simulated.width_px": 390, "simulated.height_px": 290}


def _alarm(stage: SerialStage, code: int) -> None:
    """Let the controller raise an alarm."""
    with stage.locked():
        assert isinstance(stage.firmware, GrblFirmware)
        stage.firmware.raise_alarm(code)


def _unplug(stage: SerialStage) -> None:
    """Pull the cable out."""
    with stage.locked():
        stage.line.faults = LineFaults(unplugged=True)


def _plug_in(stage: SerialStage, link: Path) -> None:
    """Put the cable in, and let the link lead to where the port is now."""
    stage.plug_in()
    link.unlink(missing_ok=True)
    link.symlink_to(stage.port)


def main(address: str, link: Path) -> None:
    """Serve until standard input ends; one answer for each line."""
    stage = SerialStage("grbl")
    config = load_bench(shipped_config("simulated.toml"), SENSOR)
    practice = PracticeBench(config, height_mm=lambda: stage.true_height_mm, address=address)
    console = PracticeConsole(practice, stage)
    own: dict[str, Callable[[], None]] = {
        "alarm": lambda: _alarm(stage, 1),
        "unplug": lambda: _unplug(stage),
        "plug-in": lambda: _plug_in(stage, link),
    }
    with stage, practice:
        _plug_in(stage, link)
        print("ready", flush=True)
        for line in sys.stdin:
            if line.strip() in own:
                own[line.strip()]()
                print("done", flush=True)
            else:
                print(console.execute(line), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
