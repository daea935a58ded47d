"""Errors of a machine's volume by homogeneous transforms, to compare the project's own with.

Reads JSON on standard input, a machine in each line:
  chain   "w C' A' X' b Y Z t"
  angles  {"eax": law in µrad}
  shifts  {"exx": [law in µm, ...], "eyx": ...}: pitch, straightness and squareness, added up
  points  {"x": the point of X's errors in mm, ...}
  rotary  {"c": {"point": mm, "shift": µm, "tilt": µrad}}
  tool    from the nose to the tip in mm
  poses   [x, y, z in mm, a, b, c in degrees], any number of them
  offsets [x, y, z in µm], which the axes of each pose get on top; none are needed
A law over the position of the axis in mm is a slope for each metre, a B-spline [order, knots, control points], or a table
{"start": mm, "step": mm, "values": [...]}, linear between its points.
Writes for each line a line: the error of the tip on the workpiece at each pose, along the machine's X, Y and Z, in µm.

Nothing is linear here: every error is a rotation and a translation between the parts that it separates. A transform is an
array of a 4 × 4 matrix for each pose, or one matrix where all poses share it.
"""

import json
import sys

import numpy as np
from scipy.interpolate import BSpline

LINEAR, ROTARY = "XYZ", "ABC"


def moved(vector):
    vector = np.asarray(vector)
    transform = np.zeros(vector.shape[:-1] + (4, 4))
    transform[..., range(4), range(4)] = 1.0
    transform[..., :3, 3] = vector
    return transform


def turned(about, angle):
    first, second = [(1, 2), (2, 0), (0, 1)][about]
    angle = np.asarray(angle)
    transform = np.zeros(angle.shape + (4, 4))
    transform[..., range(4), range(4)] = 1.0
    transform[..., first, first] = transform[..., second, second] = np.cos(angle)
    transform[..., second, first], transform[..., first, second] = np.sin(angle), -np.sin(angle)
    return transform


def tilted(urad):
    transform = np.eye(4)
    for about in range(3):
        transform = transform @ turned(about, np.asarray(urad[about]) * 1e-6)
    return transform


def law_at(law, places):
    if law is None:
        return np.zeros_like(places)
    if isinstance(law, dict):
        points = law["start"] + law["step"] * np.arange(len(law["values"]))
        return np.interp(places, points, law["values"])
    if not isinstance(law, list):
        return law * places / 1000.0
    order, knots, control = law
    inside = np.clip(places, knots[0], knots[-1])
    return BSpline(np.array(knots), np.array(control), order - 1)(inside)


def branch(machine, letters, poses, is_workpiece, has_errors):
    """The transforms from the bed to the end of a branch; letters go from the bed outwards."""
    transform = np.eye(4)
    sign = -1.0 if is_workpiece else 1.0
    for letter in letters:
        if letter in LINEAR:
            number = LINEAR.index(letter)
            places = poses[:, number]
            steps = np.zeros((len(poses), 3))
            steps[:, number] = places
            if has_errors:
                # An error is stated as the tool's on the workpiece: the workpiece goes the other way.
                for along in range(3):
                    for law in machine["shifts"].get(f"e{LINEAR[along]}{letter}".lower(), []):
                        steps[:, along] += law_at(law, places) * 1e-3
            transform = transform @ moved(sign * steps)
            if has_errors:
                names = [f"e{about}{letter}".lower() for about in ROTARY]
                urad = [law_at(machine["angles"].get(it), places) for it in names]
                point = np.array(machine["points"].get(letter.lower(), [0.0] * 3))
                transform = transform @ moved(point) @ tilted(urad) @ moved(-point)
        else:
            number = ROTARY.index(letter)
            known = machine["rotary"].get(letter.lower(), {})
            point = np.array(known.get("point", [0.0] * 3))
            line = moved(point)
            if has_errors:
                shift = np.array(known.get("shift", [0.0] * 3)) * 1e-3
                line = line @ moved(shift) @ tilted(known.get("tilt", [0.0] * 3))
            angle = sign * np.radians(poses[:, 3 + number])
            transform = transform @ line @ turned(number, angle) @ moved(-point)
    return transform


def errors(machine):
    text = machine["chain"].replace("'", "").replace(" ", "")
    workpiece, tool = text[1:-1].split("b")
    tip = np.array([*machine["tool"], 1.0])
    poses = np.array(machine["poses"])
    corrected = poses.copy()
    corrected[:, :3] += np.array(machine.get("offsets", 0.0)) * 1e-3
    seen = []
    for has_errors, driven in ((True, corrected), (False, poses)):
        of_tool = branch(machine, tool, driven, False, has_errors) @ tip
        of_workpiece = branch(machine, workpiece[::-1], driven, True, has_errors)
        seen.append(np.linalg.solve(of_workpiece, of_tool[..., None])[..., 0])
    back = branch(machine, workpiece[::-1], poses, True, False)[..., :3, :3]
    found = back @ (seen[0] - seen[1])[..., :3, None] * 1000.0
    return found[..., 0].tolist()


for line in sys.stdin:
    print(json.dumps(errors(json.loads(line))), flush=True)
