#!/usr/bin/env python3
"""Cuts frames out of a BVH file, every other byte as it is: cut_bvh.py IN.bvh OUT.bvh FIRST COUNT"""
import sys

source, target, first, count = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
lines = open(source, "rb").read().splitlines(keepends=True)
motion = next(i for i, line in enumerate(lines) if line.strip() == b"MOTION")
frames = lines[motion + 3 + first : motion + 3 + first + count]
assert len(frames) == count, f"{source} has no frames {first} to {first + count}"
header = lines[: motion + 1] + [b"Frames: %d\n" % count, lines[motion + 2]]
open(target, "wb").write(b"".join(header + frames))
