"""Stands in for LinuxCNC's screen: does what the harness says over a socket, a JSON line each way.

    {"do": "start"}                           out of the emergency stop, on, homed
    {"do": "begin", "program": "/…/a.ngc"}    loads a program and starts it
    {"do": "busy"}                            whether it still runs
    {"do": "set", "pin": NAME, "value": V}    sets a pin that nothing drives
    {"do": "get", "pins": [NAME, …]}          reads pins
    {"do": "end"}                             leaves, and LinuxCNC with it

An answer is {"ok": RESULT} or {"error": TEXT}.
"""

import json
import socket
import sys
import time

import hal
import linuxcnc

PATIENCE_S = 20.0

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def wait(what, ready):
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        status.poll()
        if ready():
            return
        time.sleep(0.01)
    raise RuntimeError(f"{what}: not within {PATIENCE_S} s; LinuxCNC says {errors.poll()}")


def mode(wanted):
    command.mode(wanted)
    wait("mode", lambda: status.task_mode == wanted)


def start(_):
    command.state(linuxcnc.STATE_ESTOP_RESET)
    wait("reset", lambda: status.task_state != linuxcnc.STATE_ESTOP)
    command.state(linuxcnc.STATE_ON)
    wait("on", lambda: status.task_state == linuxcnc.STATE_ON)
    mode(linuxcnc.MODE_MANUAL)
    command.home(-1)
    wait("home", lambda: all(status.homed[: status.joints]))
    # Joint by joint, as after homing, no external offset moves.
    command.teleop_enable(1)


def begin(request):
    mode(linuxcnc.MODE_AUTO)
    command.program_open(request["program"])
    command.auto(linuxcnc.AUTO_RUN, 0)
    wait("program", lambda: status.interp_state != linuxcnc.INTERP_IDLE)


def busy(_):
    status.poll()
    said = errors.poll()
    # Plain messages are no errors.
    if said and said[0] in (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR):
        raise RuntimeError(f"LinuxCNC says: {said[1]}")
    if status.task_state != linuxcnc.STATE_ON:
        raise RuntimeError("LinuxCNC has switched the machine off")
    return status.interp_state != linuxcnc.INTERP_IDLE or not status.inpos


def set_pin(request):
    hal.set_p(request["pin"], str(request["value"]))


def get(request):
    return [hal.get_value(pin) for pin in request["pins"]]


def main():
    component = hal.component("trueup-screen")
    component.ready()
    line = socket.create_connection(("127.0.0.1", int(sys.argv[1])), PATIENCE_S)
    line.settimeout(None)
    does = {"start": start, "begin": begin, "busy": busy, "set": set_pin, "get": get}
    for text in line.makefile("r", encoding="utf-8"):
        request = json.loads(text)
        if request["do"] == "end":
            return
        try:
            answer = {"ok": does[request["do"]](request)}
        except Exception as error:
            answer = {"error": f"{request['do']}: {error}"}
        line.sendall((json.dumps(answer) + "\n").encode())


main()
