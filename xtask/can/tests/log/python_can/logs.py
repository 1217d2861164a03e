#!/usr/bin/env python3
"""Write logs with python-can, and what is in them.

    pip install python-can==4.5.0
    python3 logs.py ../../data

python-can.asc and python-can.log hold the same messages, as its writers for Vector ASC and
candump write them. python-can.txt has a line for each: time in microseconds, channel, kind,
identifier (with an x for one of 29 bits), data length code and data bytes.
"""

import pathlib
import random
import sys

import can

MESSAGES = 400


def messages():
    chance = random.Random(1)
    at = 0
    for _ in range(MESSAGES):
        at += chance.randrange(1, 30_000)
        kind = chance.choices(["data", "remote", "fd", "error"], [12, 2, 1, 1])[0]
        extended = chance.random() < 0.3
        count = chance.choice([12, 64]) if kind == "fd" else chance.randrange(9)
        yield kind, at, can.Message(
            timestamp=at / 1e6,
            channel=chance.randrange(3),
            is_extended_id=extended,
            arbitration_id=chance.randrange(1 << 29 if extended else 1 << 11),
            is_remote_frame=kind == "remote",
            is_error_frame=kind == "error",
            is_fd=kind == "fd",
            is_rx=chance.random() < 0.7,
            dlc=count,
            data=b"" if kind in ("remote", "error") else chance.randbytes(count),
        )


def main():
    folder = pathlib.Path(sys.argv[1])
    rows = list(messages())
    for name in ("python-can.asc", "python-can.log"):
        with can.Logger(folder / name) as log:
            for _, _, message in rows:
                log(message)
    with open(folder / "python-can.txt", "w") as expected:
        for kind, at, message in rows:
            identifier = f"{message.arbitration_id}{'x' if message.is_extended_id else ''}"
            data = message.data.hex() or "-"
            print(at, message.channel, kind, identifier, message.dlc, data, file=expected)


if __name__ == "__main__":
    main()
