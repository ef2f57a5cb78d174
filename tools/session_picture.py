#!/usr/bin/env python3
"""Draws a training session as an SVG, from the data of a real one.

    tools/session_picture.py --program build/release/bin/secondskin

runs 'secondskin train' on a virtual board (about 20 s), exports, aligns and scores its recording, and
draws docs/images/session.svg: learner and expert at one instant of each repetition with the tactors
that vibrate there, and below it the whole session over time. Python 3.11, standard library only.
"""

import argparse
import csv
import json
import math
import os
import pathlib
import re
import struct
import subprocess
import tempfile
import time
import tomllib

SOURCE = pathlib.Path(__file__).resolve().parent.parent

INK, FAINT, GRID = "#1f2933", "#7b8794", "#e4e7eb"
LEARNER, LEARNER_FAR = "#3e4c59", "#616e7c"
EXPERT, EXPERT_DARK = "#a8d8c0", "#27795b"
BUZZ, BUZZ_LIGHT = "#d64545", "#f29b9b"
BAND = "#fdf3d8"


# ---- rotations: 3x3 matrices as tuples of rows

def axis_rotation(axis, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return {"X": ((1, 0, 0), (0, c, -s), (0, s, c)),
            "Y": ((c, 0, s), (0, 1, 0), (-s, 0, c)),
            "Z": ((c, -s, 0), (s, c, 0), (0, 0, 1))}[axis]


def times(a, b):
    return tuple(tuple(sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)) for i in range(3))


def apply(a, v):
    return tuple(sum(a[i][k] * v[k] for k in range(3)) for i in range(3))


def add(a, b):
    return tuple(x + y for x, y in zip(a, b))


def scaled(a, s):
    return tuple(x * s for x in a)


def angle_between(a, b):
    """The angle of the rotation from a to b [deg]."""
    trace = sum(sum(a[k][i] * b[k][i] for k in range(3)) for i in range(3))
    return math.degrees(math.acos(max(-1.0, min(1.0, (trace - 1) / 2))))


# ---- the canonical BVH that 'secondskin export' writes: metres, z up

class Bvh:
    def __init__(self, file):
        self.names, self.parent, self.offset, self.channels, self.end = [], [], [], [], {}
        stack, site = [], False
        lines = iter(pathlib.Path(file).read_text().splitlines())
        for line in lines:
            word = line.split()
            if word[0] in ("ROOT", "JOINT"):
                self.names.append(word[1])
                self.parent.append(stack[-1] if stack else None)
                self.channels.append([])
            elif word[0] == "End":
                site = True
            elif word[0] == "{":
                stack.append(None if site else len(self.names) - 1)
            elif word[0] == "}":
                site = False
                stack.pop()
            elif word[0] == "OFFSET":
                v = tuple(map(float, word[1:4]))
                if site:
                    self.end[stack[-2]] = v
                else:
                    self.offset.append(v)
            elif word[0] == "CHANNELS":
                self.channels[stack[-1]] = word[2:]
            elif word[0] == "MOTION":
                break
        next(lines)
        self.period = float(next(lines).split()[-1])
        self.frames = [list(map(float, line.split())) for line in lines if line.strip()]
        self.index = {name: i for i, name in enumerate(self.names)}
        # Where a segment ends: its end site, or the child that continues it.
        onward = {"spine_upper": "neck", "pelvis": "spine_lower"}
        for i, name in enumerate(self.names):
            if i not in self.end:
                kids = [k for k, p in enumerate(self.parent) if p == i]
                kid = self.index[onward[name]] if name in onward else kids[0]
                self.end[i] = self.offset[kid]

    def frame_at(self, t):
        return min(len(self.frames) - 1, max(0, round(t / self.period)))

    def local(self, frame):
        """Each joint's rotation in its parent, and the root's position."""
        values = iter(self.frames[frame])
        rotations, root = [], [0.0, 0.0, 0.0]
        for channels in self.channels:
            r = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
            for channel in channels:
                v = next(values)
                if channel.endswith("position"):
                    root["XYZ".index(channel[0])] = v
                else:
                    r = times(r, axis_rotation(channel[0], v))
            rotations.append(r)
        return rotations, tuple(root)

    def pose(self, frame, rotations=None):
        """Every segment's rotation and near and far end, pelvis at the origin, turned to face +x."""
        rotations = rotations or self.local(frame)[0]
        forward = apply(rotations[0], (1, 0, 0))
        heading = axis_rotation("Z", -math.degrees(math.atan2(forward[1], forward[0])))
        world, near, far = [], [], []
        for i, parent in enumerate(self.parent):
            if parent is None:
                world.append(times(heading, rotations[i]))
                near.append((0.0, 0.0, 0.0))
            else:
                world.append(times(world[parent], rotations[i]))
                near.append(add(near[parent], apply(world[parent], self.offset[i])))
            far.append(add(near[i], apply(world[i], self.end[i])))
        return world, near, far


# ---- a session

def log_times_of(recording, topic_end):
    """When a topic's messages were recorded [s since 1970], from an MCAP file's index, which is not packed."""
    data = pathlib.Path(recording).read_bytes()
    channel, times_ns, at = None, [], 8
    while at + 9 <= len(data):
        op, length = data[at], struct.unpack_from("<Q", data, at + 1)[0]
        body = data[at + 9:at + 9 + length]
        at += 9 + length
        if op == 0x04:  # channel, as repeated in the summary
            number, _, size = struct.unpack_from("<HHI", body)
            if body[8:8 + size].decode().endswith(topic_end):
                channel = number
        elif op == 0x07:  # message index
            number, size = struct.unpack_from("<HI", body)
            for k in range(size // 16):
                times_ns.append((number, struct.unpack_from("<Q", body, 6 + 16 * k)[0]))
    return sorted(t * 1e-9 for number, t in times_ns if number == channel)


PAUSE = 0.13  # the longest pause inside a pulse or saltation pattern [s]
LEAP = 0.5  # a larger change of the reference time from frame to frame is drawn as a gap [s]


class Session:
    def __init__(self, program, reference, body_map, domain, folder):
        def run(*arguments):
            return subprocess.run([program, *map(str, arguments)], check=True, stdout=subprocess.PIPE,
                                  text=True).stdout

        recording, link, drive = folder / "session.mcap", folder / "board", folder / "drive.csv"
        board = subprocess.Popen([program, "virtual-board", "--link", str(link), "--waveform", str(drive)],
                                 stdout=subprocess.PIPE, text=True)
        try:
            board.stdout.readline()  # its port: it is ready
            print(run("train", "--reference", reference, "--body-map", body_map, "--port", link,
                      "--recording", recording, "--domain", domain))
        finally:
            board.terminate()
            board.wait()
        clock = time.time() - time.monotonic()

        learner_file = re.search(r"source: (.*)", run("info", recording)).group(1)
        self.reference = json.loads(run("reference", "show", reference, "--json"))
        motion = pathlib.Path(self.reference["folder"]) / "motion.bvh"
        run("export", recording, "--to", folder / "learner.bvh")
        run("export", motion, "--to", folder / "expert.bvh")
        self.learner, self.expert = Bvh(folder / "learner.bvh"), Bvh(folder / "expert.bvh")
        self.learner_name = pathlib.Path(learner_file).name
        self.align = [json.loads(line) for line in
                      run("align", "--reference", reference, recording, "--json").splitlines()]
        self.repetitions = json.loads(run("score", "--reference", reference, recording,
                                          "--json"))["repetitions"]
        with open(SOURCE / "body_maps" / f"{body_map}.toml", "rb") as file:
            self.tactors = sorted(tomllib.load(file)["tactor"], key=lambda t: t["channel"])

        start = log_times_of(recording, "/pose")[0]
        self.drive = []  # (t, [16 drives]) whenever one changed
        with open(drive) as file:
            for row in csv.DictReader(file):
                t = int(row["monotonic_ns"]) * 1e-9 + clock - start
                self.drive.append((t, [float(row[f"drive_{i}"]) for i in range(16)]))
        self.end = self.align[-1]["t"]

    def driven(self, channel):
        """Spans [start, end, mean level] in which a tactor was driven; the pauses of pulses joined."""
        spans = []
        for (t, now), (until, _) in zip(self.drive, self.drive[1:] + [(self.end, None)]):
            if now[channel] > 0:
                if spans and t - spans[-1][1] < PAUSE:
                    spans[-1][1:] = [until, max(spans[-1][2], now[channel])]
                else:
                    spans.append([t, until, now[channel]])
        return spans

    def joint_errors(self, t):
        """Angle between learner and expert at the aligned time, by joint [deg]."""
        at = min(self.align, key=lambda a: abs(a["t"] - t))
        mine = self.learner.local(self.learner.frame_at(t))[0]
        theirs = self.expert.local(self.expert.frame_at(at["reference_t"]))[0]
        return at, {name: angle_between(mine[i], theirs[self.expert.index[name]])
                    for i, name in enumerate(self.learner.names) if self.learner.parent[i] is not None}

    def instant(self, repetition, taken):
        """The frame of a repetition, if possible with a tactor driven, with the largest weighted error."""
        best, best_t = -math.inf, None
        spans = {c: self.driven(c) for c in range(16)}
        # Not in the moment in which one place takes over from another.
        on_at = lambda t: [c for c in range(16) if any(s + 0.03 <= t < e - 0.03 for s, e, _ in spans[c])]
        leaps = [b["t"] for a, b in zip(self.align, self.align[1:])
                 if abs(b["reference_t"] - a["reference_t"]) > LEAP]
        for a in self.align:
            t = a["t"]
            if not repetition["start_s"] <= t <= repetition["end_s"] or a["phase"] != "moving":
                continue
            if any(abs(t - leap) < 0.3 for leap in leaps):
                continue
            on = on_at(t)
            _, errors = self.joint_errors(t)
            worth = max(v["weight"] * (errors[n] - v["tolerance_deg"])
                        for n, v in self.reference["joints"].items() if n in errors)
            # Rather a place on the skin that no other instant shows.
            worth += 100.0 * bool(on) + 15.0 * len({self.tactors[c]["segment"] for c in on} - taken)
            if worth > best:
                best, best_t = worth, t
        on = on_at(best_t) if best_t is not None else []
        taken |= {self.tactors[c]["segment"] for c in on}
        return best_t, on


# ---- drawing

def project(p, view):
    """Right on the paper, down, towards the viewer. view: how far the body is turned from facing us [deg]"""
    x, y, z = apply(axis_rotation("Z", view), p)
    return y, -z - 0.14 * x, x


def best_view(learner, expert, sites):
    """The direction from which learner and expert differ most and the tactors are in front."""
    def worth(view):
        points = [[project(p, view) for p in motion[1] + motion[2]] for motion in (learner, expert)]
        apart = sum(math.hypot(a[0] - b[0], a[1] - b[1]) for a, b in zip(*points)) / len(points[0])
        wide = sum(abs(p[0]) for p in points[0]) / len(points[0])
        front = sum(min(0.1, project(p, view)[2]) for p in sites) / max(1, len(sites))
        return apart + 0.5 * wide + front
    return max(range(-75, 76, 15), key=worth)


SEGMENTS = [  # joint, width [m]
    ("pelvis", 0.17), ("spine_lower", 0.17), ("spine_middle", 0.18), ("spine_upper", 0.18), ("neck", 0.07),
    ("left_clavicle", 0.08), ("right_clavicle", 0.08), ("left_shoulder", 0.085), ("right_shoulder", 0.085),
    ("left_elbow", 0.068), ("right_elbow", 0.068), ("left_wrist", 0.06), ("right_wrist", 0.06),
    ("left_hip", 0.125), ("right_hip", 0.125), ("left_knee", 0.095), ("right_knee", 0.095),
    ("left_ankle", 0.065), ("right_ankle", 0.065), ("left_toes", 0.05), ("right_toes", 0.05)]


def shade(light, dark, depth):
    """Between two colours: 0 far, 1 near."""
    k = max(0.0, min(1.0, depth))
    mix = lambda i: round(int(light[i:i + 2], 16) * (1 - k) + int(dark[i:i + 2], 16) * k)
    return f"#{mix(1):02x}{mix(3):02x}{mix(5):02x}"


def body(svg, motion, pose, view, cx, floor, scale, far_colour, near_colour):
    """A figure of capsules, far ones first, standing on the floor line. @returns where a point lands"""
    world, near, far = pose
    seen = lambda p: project(p, view)
    lowest = max(seen(p)[1] for p in near + far)
    to = lambda p: (cx + scale * seen(p)[0], floor + scale * (seen(p)[1] - lowest))
    parts = []
    for name, width in SEGMENTS:
        i = motion.index[name]
        a, b = near[i], far[i]
        if name.endswith("hip"):  # the hip's ball belongs to the pelvis
            parts.append((seen(near[0])[2] - 0.02, near[0], a, 0.13))
        parts.append(((seen(a)[2] + seen(b)[2]) / 2, a, b, width))
    head = motion.index["head"]
    centre = add(near[head], scaled(apply(world[head], motion.end[head]), 0.75))
    parts.append((seen(centre)[2], centre, None, 0.105))
    parts.sort(key=lambda p: p[0])
    for depth, a, b, width in parts:
        colour = shade(far_colour, near_colour, 0.5 + depth * 1.4)
        x, y = to(a)
        if b is None:
            svg.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{scale * width:.1f}" fill="{colour}"'
                       f' stroke="white" stroke-width="1"/>')
            continue
        u, v = to(b)
        for w, c in ((scale * width + 2, "white"), (scale * width, colour)):
            svg.append(f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}" stroke="{c}"'
                       f' stroke-width="{w:.1f}" stroke-linecap="round"/>')
    return to


def tactor_site(motion, pose, tactor):
    world, near, _ = pose
    i = motion.index[tactor["segment"]]
    a = math.radians(tactor["angle_deg"])  # 0 front, 90 left, in the rest pose
    out = (math.cos(a), math.sin(a), 0.0)
    width = dict(SEGMENTS)[tactor["segment"]] / 2
    on_axis = scaled(motion.end[i], tactor["along"])
    return add(near[i], apply(world[i], add(on_axis, scaled(out, width))))


PLACES = {"right_elbow": "right wrist", "left_elbow": "left wrist", "spine_upper": "chest",
          "right_hip": "right thigh", "left_hip": "left thigh", "right_shoulder": "right upper arm",
          "left_shoulder": "left upper arm"}


def text(svg, x, y, words, size=14, colour=INK, anchor="start", weight="normal"):
    svg.append(f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{colour}" text-anchor="{anchor}"'
               f' font-weight="{weight}">{words}</text>')


def place(tactor):
    return PLACES.get(tactor["segment"], tactor["segment"].replace("_", " "))


def places_of(session, on):
    return ", ".join(dict.fromkeys(place(session.tactors[c]) for c in on))


def draw(session):
    width, panel, left = 1120, 350, 20
    svg = []
    name = session.reference["name"].replace("_", " ")
    text(svg, left + 4, 34, f"A training session: the {name}", 22, weight="bold")
    text(svg, left + 4, 58, "One moment of each repetition. Pale green: what the expert does there."
         " Dark: the learner. Red: where the skin vibrates.", 14, FAINT)

    # The figures.
    taken, marks = set(), []
    top, floor, scale = 76, 420, 185
    for k, repetition in enumerate(session.repetitions[:3]):
        x = left + k * (panel + 15)
        t, on = session.instant(repetition, taken)
        if t is None:
            continue
        marks.append((t, k))
        at, errors = session.joint_errors(t)
        svg.append(f'<rect x="{x}" y="{top}" width="{panel}" height="424" rx="10" fill="white"'
                   f' stroke="{GRID}" stroke-width="1.5"/>')
        svg.append(f'<circle cx="{x + 24}" cy="{top + 25}" r="13" fill="{INK}"/>')
        text(svg, x + 24, top + 30, "ABC"[k], 15, "white", "middle", "bold")
        text(svg, x + 46, top + 30, f"repetition {k + 1}", 16, weight="bold")
        text(svg, x + panel - 14, top + 30, f"{t:.1f} s", 14, FAINT, "end")
        svg.append(f'<ellipse cx="{x + panel / 2}" cy="{floor + 2}" rx="135" ry="9" fill="{GRID}"/>')
        cx = x + panel / 2
        mine = session.learner.pose(session.learner.frame_at(t))
        theirs = session.expert.pose(session.expert.frame_at(at["reference_t"]))
        sites = [tactor_site(session.learner, mine, session.tactors[c]) for c in on]
        view = best_view(mine, theirs, sites)
        body(svg, session.expert, theirs, view, cx, floor, scale, "#d3ecdf", EXPERT)
        svg.append('<g opacity="0.88">')
        to = body(svg, session.learner, mine, view, cx, floor, scale, LEARNER_FAR, LEARNER)
        svg.append("</g>")
        for site in sites:
            u, v = to(site)
            for radius, opacity in ((20, 0.18), (13, 0.30)):
                svg.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{radius}" fill="none" stroke="{BUZZ}"'
                           f' stroke-width="3" opacity="{opacity + 0.25}"/>')
            svg.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="7" fill="{BUZZ}" stroke="white" stroke-width="1.5"/>')
        worst = sorted((n for n in errors if n in session.reference["joints"]),
                       key=lambda n: -session.reference["joints"][n]["weight"] * errors[n])[:2]
        text(svg, x + 18, floor + 42, "vibrates: " + (places_of(session, on) or "nothing"), 14, BUZZ, weight="bold")
        text(svg, x + 18, floor + 66, "farthest off: " + ", ".join(
            f"{n.replace('_', ' ')} {errors[n]:.0f}°" for n in worst), 13)

    # The session over time.
    x0, x1 = left + 150, width - left - 4
    shown_end = min(session.end, session.repetitions[-1]["end_s"] + 1.0)
    xs = lambda t: x0 + (x1 - x0) * t / shown_end
    y = 566
    text(svg, left + 4, y - 18, "From start to end", 17, weight="bold")
    duration = session.reference["duration_s"]
    h = 150
    raster = y + h + 96
    rows, previous = [], None
    for tactor in session.tactors:
        rows.append((tactor["channel"], place(tactor) if place(tactor) != previous else None))
        previous = place(tactor)
    step = 11
    bottom = raster + len(rows) * step + 4 * 8
    for k, repetition in enumerate(session.repetitions):
        a, b = xs(repetition["start_s"]), xs(repetition["end_s"])
        svg.append(f'<rect x="{a:.1f}" y="{y}" width="{b - a:.1f}" height="{bottom - y:.0f}" fill="{BAND}"/>')
        text(svg, (a + b) / 2, y - 22, f"repetition {k + 1}", 13, FAINT, "middle")
        text(svg, (a + b) / 2, y - 6, f"score {repetition['total']:.1f}", 15, EXPERT_DARK, "middle", "bold")
    # where in the expert's motion
    ys = lambda r: y + h - h * r / duration
    for r in range(0, int(duration) + 1):
        svg.append(f'<line x1="{x0}" y1="{ys(r):.1f}" x2="{x1}" y2="{ys(r):.1f}" stroke="{GRID}"/>')
        text(svg, x0 - 8, ys(r) + 4, f"{r} s", 12, FAINT, "end")
    text(svg, left + 4, y + 22, "Where in the", 13)
    text(svg, left + 4, y + 39, "expert's motion", 13)
    text(svg, left + 4, y + 56, "the learner is", 13)
    for repetition in session.repetitions:
        run, last = [], None
        for a in session.align:
            if not repetition["start_s"] <= a["t"] <= repetition["end_s"]:
                continue
            if last is not None and abs(a["reference_t"] - last) > LEAP:
                run.append([])
            if not run:
                run.append([])
            run[-1].append(f"{xs(a['t']):.1f},{ys(a['reference_t']):.1f}")
            last = a["reference_t"]
        for points in run:
            svg.append(f'<polyline points="{" ".join(points)}" fill="none" stroke="{EXPERT_DARK}"'
                       f' stroke-width="3.5" stroke-linejoin="round" stroke-linecap="round"/>')
    # tempo
    ty, th = y + h + 22, 44
    text(svg, left + 4, ty + 18, "Tempo against", 13)
    text(svg, left + 4, ty + 35, "the expert's", 13)
    top_tempo = 2.0
    yt = lambda v: ty + th - th * min(v, top_tempo) / top_tempo
    for v, label in ((0, "still"), (1, "same"), (2, "twice")):
        svg.append(f'<line x1="{x0}" y1="{yt(v):.1f}" x2="{x1}" y2="{yt(v):.1f}" stroke="{GRID}"/>')
        text(svg, x0 - 8, yt(v) + 4, label, 12, FAINT, "end")
    for repetition in session.repetitions:
        points = [f"{xs(a['t']):.1f},{yt(a['tempo']):.1f}" for a in session.align
                  if repetition["start_s"] <= a["t"] <= repetition["end_s"]]
        svg.append(f'<polyline points="{" ".join(points)}" fill="none" stroke="{LEARNER}" stroke-width="2"/>')
    # tactors
    ry = raster
    text(svg, left + 4, ry + 10, "Vibration", 13)
    for channel, name_of_place in rows:
        if name_of_place:
            if ry > raster:
                ry += 8
            count = sum(place(t) == name_of_place for t in session.tactors)
            text(svg, x0 - 8, ry + step * count / 2 + 4, name_of_place, 12, FAINT, "end")
        svg.append(f'<line x1="{x0}" y1="{ry + step / 2:.1f}" x2="{x1}" y2="{ry + step / 2:.1f}"'
                   f' stroke="{GRID}"/>')
        for a, b, level in session.driven(channel):
            if a > shown_end:
                continue
            svg.append(f'<rect x="{xs(a):.1f}" y="{ry + 1:.1f}" width="{max(1.5, xs(b) - xs(a)):.1f}"'
                       f' height="{step - 2}" rx="2" fill="{shade(BUZZ_LIGHT, BUZZ, level)}"/>')
        ry += step
    for t, k in marks:
        svg.append(f'<line x1="{xs(t):.1f}" y1="{y}" x2="{xs(t):.1f}" y2="{ry:.1f}" stroke="{INK}"'
                   f' stroke-dasharray="4 3"/>')
        svg.append(f'<circle cx="{xs(t):.1f}" cy="{ry + 11:.1f}" r="10" fill="{INK}"/>')
        text(svg, xs(t), ry + 16, "ABC"[k], 13, "white", "middle", "bold")
    for s in range(0, int(shown_end) + 1):
        if all(abs(xs(s) - xs(t)) > 26 for t, _ in marks):
            text(svg, xs(s), ry + 16, f"{s} s", 12, FAINT, "middle")
    height = ry + 36
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height:.0f}"'
            f' font-family="DejaVu Sans, Verdana, Arial, sans-serif">\n'
            f'<title>A training session: {name}</title>\n'
            f'<rect width="{width}" height="{height:.0f}" fill="#fbfcfd"/>\n' + "\n".join(svg) + "\n</svg>\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=str(SOURCE / "build/release/bin/secondskin"))
    parser.add_argument("--reference", default="deep_squat")
    parser.add_argument("--body-map", default="full_body")
    parser.add_argument("--domain", default="7")
    parser.add_argument("--out", type=pathlib.Path, default=SOURCE / "docs/images/session.svg")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        session = Session(options.program, options.reference, options.body_map, options.domain,
                          pathlib.Path(folder))
    if not session.repetitions:
        raise SystemExit(f"{options.reference}: the session has no repetition to draw")
    options.out.write_text(draw(session))
    print(f"wrote {options.out} ({os.path.getsize(options.out) // 1024} kB)")


if __name__ == "__main__":
    main()
