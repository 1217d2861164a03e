"""Counts what is in the files of a run, with the readers of PyPI that are installed."""

import collections
import json
import pathlib
import sys

folder, network = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
found = {"mcap": None, "can": None, "cantools": None, "canmatrix": None}
signals = []
try:
    from mcap.reader import make_reader

    counts = collections.Counter()
    with open(folder / "run.mcap", "rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            data = json.loads(message.data)
            counts[channel.topic] += 1
            if channel.topic.startswith("/signals/"):
                signals.append((channel.topic.removeprefix("/signals/"), data))
    found["mcap"] = dict(sorted(counts.items()))
except ImportError:
    pass
try:
    import can

    messages = list(can.LogReader(folder / "bus.log"))
    errors = sum(message.is_error_frame for message in messages)
    found["can"] = [len(messages) - errors, errors]
except ImportError:
    pass
try:
    import can
    import cantools

    database = cantools.database.load_file(network)
    decoded = []
    for message in can.LogReader(folder / "bus.log"):
        known = [one for one in database.messages if one.frame_id == message.arbitration_id]
        if message.is_error_frame or not known:
            continue
        # The first reference of a master ends before the last signal.
        values = known[0].decode(message.data, decode_choices=False, allow_truncated=True)
        decoded.append((known[0].name, values))
    # What the recording has as a number.
    numbers = 0
    for (name, values), (other, recorded) in zip(decoded, signals, strict=True):
        assert name == other, (name, other)
        for signal, value in recorded.items():
            if not isinstance(value, str) and signal in values:
                assert abs(value - values[signal]) < 1e-9 * max(1, abs(value)), (name, signal)
                numbers += 1
    found["cantools"] = [len(decoded), numbers]
except ImportError:
    pass
try:
    import canmatrix.formats

    matrix = canmatrix.formats.loadp_flat(str(network))
    found["canmatrix"] = sorted(frame.name for frame in matrix.frames)
except ImportError:
    pass
print(json.dumps(found))
