"""Stands in for LinuxCNC's screen: moves the joints and reads what the compensation adds.

Reads `moves.json` (a list of positions of X, Y, Z in mm) beside this file's argument folder, and
writes `result.json` there: for each move, what each joint's motor command is off its position
command, in mm, once the backlash filter has settled.
"""

import json
import os
import sys
import time

import hal
import linuxcnc

folder = sys.argv[1]
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def wait(what, ready, seconds=10.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status.poll()
        if ready():
            return
        time.sleep(0.002)
    raise RuntimeError(f"{what}: not within {seconds} s; LinuxCNC says {errors.poll()}")


def read(joint, pin):
    return hal.get_value(f"joint.{joint}.{pin}")


def settled():
    """The filter ends a few billionths beside its goal, so it is watched until it rests."""
    before, rests = None, 0
    end = time.monotonic() + 10.0
    while rests < 5:
        now = [read(joint, "backlash-filt") for joint in range(3)]
        rests = rests + 1 if now == before else 0
        before = now
        if time.monotonic() > end:
            raise RuntimeError("the backlash filter does not come to rest")
        time.sleep(0.002)


def main():
    component = hal.component("trueup-test")
    component.ready()
    with open(os.path.join(folder, "moves.json")) as file:
        moves = json.load(file)
    command.state(linuxcnc.STATE_ESTOP_RESET)
    wait("reset", lambda: status.task_state != linuxcnc.STATE_ESTOP)
    command.state(linuxcnc.STATE_ON)
    wait("on", lambda: status.task_state == linuxcnc.STATE_ON)
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.home(-1)
    wait("home", lambda: all(status.homed[:3]))
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete()
    result = []
    for x, y, z in moves:
        command.mdi(f"G53 G0 X{x:.6f} Y{y:.6f} Z{z:.6f}")
        command.wait_complete(10.0)
        wait("move", lambda: status.inpos and status.interp_state == linuxcnc.INTERP_IDLE)
        settled()
        result.append([
            read(joint, "motor-pos-cmd") - read(joint, "pos-cmd") - read(joint, "motor-offset")
            for joint in range(3)
        ])
    with open(os.path.join(folder, "result.json"), "w") as file:
        json.dump(result, file)


try:
    main()
except Exception as error:
    with open(os.path.join(folder, "failed.txt"), "w") as file:
        file.write(f"{type(error).__name__}: {error}")
    sys.exit(1)
