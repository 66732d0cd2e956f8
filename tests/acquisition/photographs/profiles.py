"""Colour profiles of the tests, written byte by byte as ICC.1:2022 lays them out."""

import struct

S15 = 65536.0


def curve_of(*entries: int) -> bytes:
    """curveType (10.6): nothing is linear, one entry a gamma in u8Fixed8, more a table."""
    return struct.pack(f">4s4xI{len(entries)}H", b"curv", len(entries), *entries)


def gamma_curve(gamma: float) -> bytes:
    return curve_of(round(gamma * 256))


def parametric(kind: int, *parameters: float) -> bytes:
    """parametricCurveType (10.18)."""
    numbers = [round(value * S15) for value in parameters]
    return struct.pack(f">4s4xHxx{len(numbers)}i", b"para", kind, *numbers)


def profile(*curves: bytes, space: bytes = b"RGB ", name: str = "made") -> bytes:
    """A profile with these curves: one for all of red, green and blue, one each, or one of grey."""
    names = (b"kTRC",) if space == b"GRAY" else (b"rTRC", b"gTRC", b"bTRC")
    tags = {b"desc": struct.pack(f">4s4xI{len(name) + 1}s", b"desc", len(name) + 1, name.encode())}
    if curves:
        tags |= {tag: curves[i % len(curves)] for i, tag in enumerate(names)}
    at = 132 + 12 * len(tags)
    table, content = struct.pack(">I", len(tags)), b""
    for tag, value in tags.items():
        value += bytes(-len(value) % 4)
        table += struct.pack(">4sII", tag, at + len(content), len(value))
        content += value
    head = struct.pack(">I8x4s4s4s12x4s88x", at + len(content), b"mntr", space, b"XYZ ", b"acsp")
    # Version 4.4 in bytes 8 to 11.
    return head[:8] + b"\4\x40\0\0" + head[12:] + table + content


SRGB_CURVE = parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
DISPLAY_P3 = profile(SRGB_CURVE, name="Display P3")
