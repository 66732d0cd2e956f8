"""A network of the tests' own, with nothing but the loopback interface; Linux only.

What is broadcast there reaches nobody else.
"""

import fcntl
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
WITHIN_S = 120.0
GET_FLAGS, SET_FLAGS, SET_ADDRESS = 0x8913, 0x8914, 0x8916
"""``SIOCGIFFLAGS``, ``SIOCSIFFLAGS`` and ``SIOCSIFADDR`` of Linux."""
IFF_UP = 1


def run_in_own_network(function: str) -> Any:
    """Run ``module:function`` in a network namespace of its own; return what it returns.

    The test is skipped where no namespace can be made.
    """
    unshare = shutil.which("unshare")
    if unshare is None:
        pytest.skip("unshare, which makes a network of the test's own, is not installed")
    alone = [unshare, "--map-root-user", "--net"]
    if subprocess.run([*alone, "true"], check=False, capture_output=True).returncode != 0:
        pytest.skip("this system does not let the tests make a network of their own")
    done = subprocess.run(
        [*alone, sys.executable, "-m", "tests.hil_mocks.own_network", function],
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def give_address(address: str) -> None:
    """Give the loopback interface one address more."""
    packed = struct.pack("16sHH4s8x", b"lo:1", socket.AF_INET, 0, socket.inet_aton(address))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SET_ADDRESS, packed)


def _bring_up_loopback() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sh14x", b"lo", 0)
        _, flags = struct.unpack("16sh14x", fcntl.ioctl(any_socket, GET_FLAGS, request))
        fcntl.ioctl(any_socket, SET_FLAGS, struct.pack("16sh14x", b"lo", flags | IFF_UP))


if __name__ == "__main__":
    from importlib import import_module

    module, _, name = sys.argv[1].partition(":")
    _bring_up_loopback()
    sys.stdout.write(json.dumps(getattr(import_module(module), name)()) + "\n")
