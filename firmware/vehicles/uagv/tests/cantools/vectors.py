#!/usr/bin/env python3
"""Write frames of network.dbc as the DBC library cantools packs them.

    pip install cantools==45.1.0
    python3 vectors.py > ../data/cantools.txt
    python3 vectors.py tilt.dbc > ../data/cantools_tilt.txt

With the name of a supplement: frames of the messages that it adds.

One frame a line: identifier, data bytes, then for each signal in the order of
the network file its raw number and its physical value. For every message the
limits of all its signals, then random numbers between them.
"""

import pathlib
import random
import sys

import cantools

RANDOM_FRAMES = 10


def raw_limits(signal):
    if signal.choices:
        return min(signal.choices), max(signal.choices)
    offset, scale = signal.offset, signal.scale
    return round((signal.minimum - offset) / scale), round((signal.maximum - offset) / scale)


def line(message, raw):
    data = message.encode(raw, scaling=False, strict=False)
    physical = message.decode(data, decode_choices=False)
    assert message.decode(data, scaling=False, decode_choices=False) == raw
    signals = " ".join(f"{raw[s.name]}={physical[s.name]!r}" for s in file_order(message))
    return f"{message.frame_id} {data.hex()} {signals}"


def file_order(message):
    """cantools sorts signals by position; the file's lines give their order."""
    return sorted(message.signals, key=lambda s: ORDER[message.name, s.name])


def order(text):
    order, message = {}, None
    for number, words in enumerate(map(str.split, text.splitlines())):
        if words[:1] == ["BO_"]:
            message = words[2].rstrip(":")
        elif words[:1] == ["SG_"]:
            order[message, words[1]] = number
    return order


FOLDER = pathlib.Path(__file__).resolve().parents[2]
NETWORK = (FOLDER / "network.dbc").read_text()
ADDED = "".join((FOLDER / name).read_text() for name in sys.argv[1:])
ORDER = order(NETWORK + "\n" + ADDED)

database = cantools.database.load_string(NETWORK + "\n" + ADDED, "dbc", strict=True)
WANTED = {name for name, _ in order(ADDED or NETWORK)}
source = random.Random(1)
for message in sorted(database.messages, key=lambda m: m.frame_id):
    if message.name not in WANTED:
        continue
    limits = {s.name: raw_limits(s) for s in message.signals}
    frames = [{name: low for name, (low, _) in limits.items()}]
    frames += [{name: high for name, (_, high) in limits.items()}]
    for _ in range(RANDOM_FRAMES):
        frames += [{name: source.randint(*pair) for name, pair in limits.items()}]
    for raw in frames:
        print(line(message, raw))
