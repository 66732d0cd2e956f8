"""``standoff doctor`` and ``standoff cameras``: is the bench ready, and which cameras are there."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from typer import Context, Exit, Option

from standoff import library, terminal

_RULES = (terminal.needs("settings", "bench"),)


def doctor(
    context: Context,
    *,
    bench: Annotated[
        Path | None,
        Option("--bench", help="Bench file (TOML); without it, only this computer is checked."),
    ] = None,
    settings: terminal.BenchKeys = None,
    json: terminal.Json = False,
) -> None:
    """Check that this computer, the camera and the stage are ready, and say what to do if not."""
    terminal.check_options(context, _RULES)
    from standoff.doctor import examine

    config = None if bench is None else terminal.read_bench(bench, settings)
    checks = examine(config, Path.cwd())
    failed = [check for check in checks if check.status == "fail"]
    if json:
        terminal.print_json({"ok": not failed, "checks": [asdict(check) for check in checks]})
    else:
        for check in checks:
            terminal.say(f"{check.status:4}  {check.name}: {check.found}")
            if check.remedy:
                terminal.say(f"      -> {check.remedy}")
    if failed:
        raise Exit(1)


def cameras(*, json: terminal.Json = False) -> None:
    """Search for cameras; this BROADCASTS on every network interface of this computer."""
    found = library.find_cameras()
    if json:
        terminal.print_json({"cameras": [asdict(camera) for camera in found]})
        return
    if not found:
        terminal.say(
            "no camera answered; check power, cable and firewall, and that the network card has "
            "an address in the camera's subnet"
        )
        return
    terminal.print_table(
        f"{len(found)} camera{'s' * (len(found) != 1)}",
        ["address", "vendor", "model", "serial number", "hardware address", "id"],
        [[c.address, c.vendor, c.model, c.serial_number, c.hardware_address, c.id] for c in found],
    )
