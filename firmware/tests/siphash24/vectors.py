"""Writes tags computed by the package siphash24 of PyPI: tags.txt, references.txt and sessions.txt
in firmware/tests/data.

    pip install siphash24
    python3 vectors.py

A line of tags.txt is: key, identifier, system time, data, bits of the tag, tag. One of references.txt
is: key, identifier, data, the byte from which the next reference takes its tag. One of sessions.txt is: key of
the network, numbers of the starts in the order of their places, key of the session. Keys and data are bytes in
their order; the others are numbers.
"""

import pathlib
import random

import siphash24

DATA = pathlib.Path(__file__).parent.parent / "data"


def code(text, key):
    return int.from_bytes(siphash24.siphash24(text, key=key).digest(), "little")


random.seed(300)
lines = []
for index in range(200):
    key = random.randbytes(16)
    identifier = random.randrange(2048)
    time = random.choice([0, 1, 2**31, 2**32 - 1, random.randrange(2**32)])
    data = random.randbytes(8)
    mask = random.choice([0xFFFF_F8F8_0000_0000, 0xFFFF_0000_0000_0000, random.getrandbits(64)])
    covered = int.from_bytes(data, "little") & ~mask
    text = covered.to_bytes(8, "little") + time.to_bytes(4, "little") + identifier.to_bytes(2, "little")
    lines.append(f"{key.hex()} {identifier} {time} {data.hex()} {mask} {code(text, key) & mask}\n")
(DATA / "tags.txt").write_text("".join(lines))

# Identifier and length stand in the place of the time, and a number that is no identifier in that of
# the identifier.
REFERENCE = 0xFFFE
lines = []
for index in range(100):
    key = random.randbytes(16)
    identifier = random.randrange(2048)
    data = random.randbytes(random.randrange(5, 9))
    text = data.ljust(8, b"\0") + (identifier << 4 | len(data)).to_bytes(4, "little")
    text += REFERENCE.to_bytes(2, "little")
    lines.append(f"{key.hex()} {identifier} {data.hex()} {code(text, key) & 0xFF}\n")
(DATA / "references.txt").write_text("".join(lines))

# Both halves of the next key, each under a number that is no identifier.
HALVES = [0xFFFD, 0xFFFC]
lines = []
for index in range(100):
    network = random.randbytes(16)
    starts = [random.choice([1, 2**32 - 1, random.randrange(1, 2**32)]) for _ in range(2)]
    key = network
    for place, start in enumerate(starts):
        text = start.to_bytes(8, "little") + place.to_bytes(4, "little")
        halves = [code(text + half.to_bytes(2, "little"), key) for half in HALVES]
        key = b"".join(half.to_bytes(8, "little") for half in halves)
    lines.append(f"{network.hex()} {starts[0]} {starts[1]} {key.hex()}\n")
(DATA / "sessions.txt").write_text("".join(lines))
