#!/usr/bin/env python3
"""Joins repetitions of UI-PRMD marker files into one recording.

Between two repetitions every marker goes straight from its last place to its next first one for half a
second. A marker that is a gap (0, 0, 0) at either end stays a gap. 100 Hz, 117 columns, as in the data set.

Example:
  tools/join_ui_prmd.py m01_s06_e02_positions_inc.txt.gz m01_s06_e03_positions_inc.txt.gz > joined.txt
"""
import gzip
import sys

BLEND = 50  # frames


def rows(name):
    opener = gzip.open if name.endswith(".gz") else open
    with opener(name, "rt") as lines:
        table = [[float(x) for x in line.replace(",", " ").split()] for line in lines if line.strip()]
    if not table or any(len(row) != 117 for row in table):
        sys.exit(f"{name}: expected lines of 117 numbers")
    return table


def main():
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        sys.exit(__doc__)
    out = []
    for name in sys.argv[1:]:
        table = rows(name)
        if out:
            last, first = out[-1], table[0]
            for k in range(1, BLEND):
                u = k / BLEND
                row = []
                for m in range(39):
                    a, b = last[3 * m : 3 * m + 3], first[3 * m : 3 * m + 3]
                    gap = not any(a) or not any(b)
                    row += [0.0, 0.0, 0.0] if gap else [p + u * (q - p) for p, q in zip(a, b)]
                out.append(row)
        out += table
    for row in out:
        print(",".join(f"{x:.3f}" for x in row))


main()
