"""Writes the frames of a candump log as can_msgs/msg/Frame in an MCAP file: LOG FILE COMPRESSION."""

import struct
import sys

try:
    from mcap.writer import CompressionType, Writer
except ImportError:
    print("absent")
    sys.exit()

log, file, compression = sys.argv[1:]
with open(file, "wb") as out:
    writer = Writer(out, chunk_size=4096, compression=CompressionType[compression])
    writer.start(profile="ros2", library="test")
    text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    other = writer.register_channel("/chatter", "cdr", text)
    schema = writer.register_schema("can_msgs/msg/Frame", "ros2msg", b"std_msgs/Header header\n...")
    channel = writer.register_channel("/from_can_bus", "cdr", schema)
    for line in open(log):
        stamp, _, frame = line.split()
        seconds, micros = stamp.strip("()").split(".")
        at = int(seconds) * 10**9 + int(micros) * 1000
        name, _, data = frame.partition("#")
        remote = data.startswith("R")
        content = b"" if remote else bytes.fromhex(data)
        length = int(data[1:] or 0) if remote else len(content)
        message = struct.pack("<4xIII5s3xI????8s", at // 10**9, at % 10**9, 5, b"can0\0",
                              int(name, 16), remote, len(name) > 3, False, False, content)
        message = bytearray(b"\0\1\0\0" + message[4:])
        message[-9] = length
        # A recorder is later than the driver.
        writer.add_message(channel, at + 12345, bytes(message), at)
        writer.add_message(other, at + 12345, b"\0\1\0\0\3\0\0\0hi\0", at)
    writer.finish()
print("written")
