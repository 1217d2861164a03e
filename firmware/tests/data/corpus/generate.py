"""Writes the corpus: streams that a receiver's line may carry when something is wrong.

Run in this folder; the files depend on nothing but this program and ../sbp_packets.json.
"""

import json
import pathlib
import random
import struct

HERE = pathlib.Path(__file__).parent
PACKETS = [bytes.fromhex(p["hex"]) for p in json.loads((HERE / "../sbp_packets.json").read_text())]
RANDOM = random.Random(2017)

# Message types of the receiver (libsbp: navigation messages, current and deprecated).
SIZES = {
    0x0102: 11, 0x020A: 34, 0x020C: 22, 0x020E: 22, 0x020F: 10, 0xFFFF: 4,
    0x0100: 11, 0x0201: 34, 0x0203: 22, 0x0205: 22, 0x0207: 10,
}


def crc(data):
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def frame(kind, payload):
    body = struct.pack("<HHB", kind, 0x1234, len(payload)) + payload
    return b"\x55" + body + struct.pack("<H", crc(body))


def flipped(packet):
    at = RANDOM.randrange(len(packet))
    return packet[:at] + bytes([packet[at] ^ 1 << RANDOM.randrange(8)]) + packet[at + 1 :]


def lying(packet):
    return packet[:5] + bytes([RANDOM.randrange(256)]) + packet[6:]


def extreme(kind):
    size = SIZES[kind]
    yield b"\xff" * size
    yield b"\x00" * size
    yield b"\x80" * size
    if size == 34:
        for degrees in (float("nan"), float("inf"), -1e300, 1e-320, 400.0):
            yield struct.pack("<I3d", 0xFFFFFFFF, degrees, degrees, degrees) + b"\xff\xff\xff\xff\xff\x04"
    if size == 22:
        yield struct.pack("<I3i", 604_799_900, -(2**31), 2**31 - 1, -1) + b"\xff\xff\xff\xff\xff\x04"


FILES = {
    "truncated_headers": b"".join(p[: 1 + i % 7] for i, p in enumerate(PACKETS * 4)),
    "truncated_payloads": b"".join(p[: 6 + RANDOM.randrange(len(p) - 6)] for p in PACKETS),
    "flipped_bits": b"".join(flipped(p) for p in PACKETS),
    "lying_lengths": b"".join(lying(p) for p in PACKETS),
    "preambles": b"\x55" * 1000,
    "noise": RANDOM.randbytes(2048),
    "nested": b"".join(frame(0x0204, a[:100] + b[:100])[:-1] + b"\x00" for a, b in zip(PACKETS, PACKETS[1:])),
    "back_to_back": b"".join(PACKETS),
    "empty": b"".join(frame(kind, b"") for kind in SIZES),
    "short": b"".join(frame(kind, b"\x01" * (size - 1)) for kind, size in SIZES.items()),
    "long": b"".join(frame(kind, b"\x02" * 255) for kind in SIZES),
    "extremes": b"".join(frame(kind, payload) for kind in SIZES for payload in extreme(kind)),
}

for name, content in FILES.items():
    (HERE / f"{name}.bin").write_bytes(content)
