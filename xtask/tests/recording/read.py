"""Counts what is in the files of a run, with the readers of PyPI that are installed."""

import collections
import json
import pathlib
import sys

folder = pathlib.Path(sys.argv[1])
found = {"mcap": None, "can": None}
try:
    from mcap.reader import make_reader

    counts = collections.Counter()
    with open(folder / "run.mcap", "rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            json.loads(message.data)
            counts[channel.topic] += 1
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
print(json.dumps(found))
