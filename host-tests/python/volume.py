"""Errors of a machine's volume by homogeneous transforms, to compare the project's own with.

Reads JSON on standard input: a list of machines, each
  chain   "w C' A' X' b Y Z t"
  angles  {"eax": [order, knots in mm, control points in µrad] or a slope in µrad/m}
  points  {"x": the point of X's errors in mm, ...}
  rotary  {"c": {"point": mm, "shift": µm, "tilt": µrad}}
  tool    from the nose to the tip in mm
  poses   [x, y, z in mm, a, b, c in degrees]
Writes the error of the tip on the workpiece at each pose, along the machine's X, Y and Z, in µm.

Nothing is linear here: every error is a rotation and a translation between the parts that it separates.
"""

import json
import sys

import numpy as np
from scipy.interpolate import BSpline

LINEAR, ROTARY = "XYZ", "ABC"


def moved(vector):
    transform = np.eye(4)
    transform[:3, 3] = vector
    return transform


def turned(about, angle):
    first, second = [(1, 2), (2, 0), (0, 1)][about]
    transform = np.eye(4)
    transform[first, first] = transform[second, second] = np.cos(angle)
    transform[second, first], transform[first, second] = np.sin(angle), -np.sin(angle)
    return transform


def tilted(urad):
    transform = np.eye(4)
    for about in range(3):
        transform = transform @ turned(about, urad[about] * 1e-6)
    return transform


def angle_urad(angle, place):
    if angle is None:
        return 0.0
    if not isinstance(angle, list):
        return angle * place / 1000.0
    order, knots, control = angle
    inside = min(max(place, knots[0]), knots[-1])
    return float(BSpline(np.array(knots), np.array(control), order - 1)(inside))


def branch(machine, letters, pose, is_workpiece, has_errors):
    """The transform from the bed to the end of a branch; letters go from the bed outwards."""
    transform = np.eye(4)
    sign = -1.0 if is_workpiece else 1.0
    for letter in letters:
        if letter in LINEAR:
            number = LINEAR.index(letter)
            step = np.zeros(3)
            step[number] = sign * pose[number]
            transform = transform @ moved(step)
            if has_errors:
                names = [f"e{about}{letter}".lower() for about in ROTARY]
                urad = [angle_urad(machine["angles"].get(it), pose[number]) for it in names]
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
            angle = sign * np.radians(pose[3 + number])
            transform = transform @ line @ turned(number, angle) @ moved(-point)
    return transform


def errors(machine):
    text = machine["chain"].replace("'", "").replace(" ", "")
    workpiece, tool = text[1:-1].split("b")
    tip = np.array([*machine["tool"], 1.0])
    found = []
    for pose in machine["poses"]:
        seen = []
        for has_errors in (True, False):
            of_tool = branch(machine, tool, pose, False, has_errors)
            of_workpiece = branch(machine, workpiece[::-1], pose, True, has_errors)
            seen.append(np.linalg.solve(of_workpiece, of_tool @ tip))
        back = branch(machine, workpiece[::-1], pose, True, False)[:3, :3]
        found.append((back @ (seen[0] - seen[1])[:3] * 1000.0).tolist())
    return found


json.dump([errors(machine) for machine in json.load(sys.stdin)], sys.stdout)
