"""Writes tags computed by the package siphash24 of PyPI: firmware/tests/data/tags.txt.

    pip install siphash24
    python3 vectors.py > ../data/tags.txt

A line is: key, identifier, system time, data, bits of the tag, tag. Key and data are bytes in their
order; the others are numbers.
"""

import random

import siphash24

random.seed(300)
for index in range(200):
    key = random.randbytes(16)
    identifier = random.randrange(2048)
    time = random.choice([0, 1, 2**31, 2**32 - 1, random.randrange(2**32)])
    data = random.randbytes(8)
    mask = random.choice([0xFFFF_F8F8_0000_0000, 0xFFFF_0000_0000_0000, random.getrandbits(64)])
    covered = int.from_bytes(data, "little") & ~mask
    text = covered.to_bytes(8, "little") + time.to_bytes(4, "little") + identifier.to_bytes(2, "little")
    code = int.from_bytes(siphash24.siphash24(text, key=key).digest(), "little")
    print(key.hex(), identifier, time, data.hex(), mask, code & mask)
