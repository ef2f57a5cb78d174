#!/usr/bin/env python3
"""Cuts frames out of an Intel C3D file: cut_c3d.py IN.c3d OUT.c3d FIRST COUNT

FIRST counts from 0. Changes the numbers of first and last frame (header, TRIAL) and their count
(POINT:FRAMES); every other byte is as it is.
"""
import struct
import sys

source, target, first, count = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
data = bytearray(open(source, "rb").read())
begin = (data[0] - 1) * 512
assert data[begin + 3] == 84, "not an Intel file"
points, samples, first_frame, last_frame = struct.unpack_from("<4H", data, 2)
(scale,) = struct.unpack_from("<f", data, 12)
(data_block,) = struct.unpack_from("<H", data, 16)
frame_bytes = (4 * points + samples) * (4 if scale < 0 else 2)
start = (data_block - 1) * 512 + first * frame_bytes
assert first_frame + first + count - 1 <= last_frame, f"{source} has no such frames"

def find(group, name):
    """Where the values of a parameter begin."""
    ids, at = {}, begin + 4
    found = {}
    while data[at]:
        length, number = struct.unpack_from("bb", data, at)
        text = bytes(data[at + 2 : at + 2 + abs(length)]).decode()
        pointer = at + 2 + abs(length)
        if number < 0:
            ids[-number] = text
        else:
            found[number, text] = pointer + 4 + data[pointer + 3]
        at = pointer + struct.unpack_from("<H", data, pointer)[0]
    return next((p for (n, t), p in found.items() if ids[n] == group and t == name), None)

first_frame, last_frame = first_frame + first, first_frame + first + count - 1
struct.pack_into("<2H", data, 6, first_frame, last_frame)
struct.pack_into("<H", data, find("POINT", "FRAMES"), count)
for name, frame in ("ACTUAL_START_FIELD", first_frame), ("ACTUAL_END_FIELD", last_frame):
    if find("TRIAL", name) is not None:
        struct.pack_into("<I", data, find("TRIAL", name), frame)
head = data[: (data_block - 1) * 512]
open(target, "wb").write(head + data[start : start + count * frame_bytes])
