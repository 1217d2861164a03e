"""Writes tags computed by the package siphash24 of PyPI: tags.txt and references.txt in
firmware/tests/data.

    pip install siphash24
    python3 vectors.py

A line of tags.txt is: key, identifier, system time, data, bits of the tag, tag. One of references.txt
is: key, identifier, data, the byte from which the next reference takes its tag. Key and data are bytes
in their order; the others are numbers.
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
