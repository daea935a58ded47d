"""Stands in for LinuxCNC's screen: does what it is told over a socket, one JSON line each way.

Connects to the port of the loopback that is its argument. A request is `{"do": verb, …}` with the
arguments of the function of that name below; the answer is `{"ok": value}` or `{"error": text}`.
When the line closes, the screen goes, and LinuxCNC with it.
"""

import json
import socket
import subprocess
import sys
import tempfile
import time

import hal
import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
component = hal.component("screen")
component.newpin("scenario", hal.HAL_S32, hal.HAL_OUT)
component.newpin("zero", hal.HAL_BIT, hal.HAL_OUT)
component.ready()

STATES = {
    "estop": (linuxcnc.STATE_ESTOP, linuxcnc.STATE_ESTOP),
    "reset": (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ESTOP_RESET),
    "off": (linuxcnc.STATE_OFF, linuxcnc.STATE_ESTOP_RESET),
    "on": (linuxcnc.STATE_ON, linuxcnc.STATE_ON),
}
MODES = {
    "manual": linuxcnc.MODE_MANUAL,
    "mdi": linuxcnc.MODE_MDI,
    "auto": linuxcnc.MODE_AUTO,
}


def wait(what, ready, seconds=20.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status.poll()
        if ready():
            return
        time.sleep(0.005)
    raise RuntimeError(f"{what}: not within {seconds} s; LinuxCNC says {said()}")


def said():
    texts = []
    while (message := errors.poll()) is not None:
        texts.append(message[1])
    return texts


def state(name):
    """Asks until it is so: just after its start LinuxCNC does not take every command."""
    asked, reached = STATES[name]

    def there():
        if name == "reset":
            return status.task_state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON)
        return status.task_state == reached

    for _ in range(20):
        status.poll()
        if there():
            return
        command.state(asked)
        try:
            return wait(name, there, 1.0)
        except RuntimeError:
            pass
    raise RuntimeError(f"{name} is not reached; LinuxCNC says {said()}")


def mode(name):
    command.mode(MODES[name])
    command.wait_complete()
    wait(name, lambda: status.task_mode == MODES[name])


def begin_home(joint):
    mode("manual")
    command.teleop_enable(0)
    command.wait_complete()
    command.home(joint)


def home(joint=-1):
    begin_home(joint)
    if joint >= 0:
        wait("homing", lambda: not status.homed[joint], 5.0)
    wait("home", lambda: all(status.homed[: status.joints]))


def jog(axis, speed, seconds=None):
    """Jogs an axis for that long, or until it stands: at its limit, or stopped by something else."""
    mode("manual")
    command.teleop_enable(1)
    command.wait_complete()
    command.jog(linuxcnc.JOG_CONTINUOUS, 0, axis, speed)
    time.sleep(0.2 if seconds is None else seconds)
    if seconds is None:
        wait("jog", lambda: stands(axis))
    # At a limit the jog goes on until the key is released: LinuxCNC changes no mode before.
    command.jog(linuxcnc.JOG_STOP, 0, axis)
    command.wait_complete()
    wait("jog", lambda: status.inpos)


def stands(axis):
    """Whether an axis stands: while it jogs, LinuxCNC calls it in position. Without a realtime kernel the servo thread
    itself may stand for one of the three looks. An axis whose feed is held goes on later."""
    pin = f"axis.{'xyzabcuvw'[axis]}.pos-cmd"
    for _ in range(3):
        if hal.get_value("motion.feed-inhibit"):
            return False
        before = hal.get_value(pin)
        time.sleep(0.05)
        if abs(hal.get_value(pin) - before) >= 1e-6:
            return False
    return True


def unhome():
    mode("manual")
    command.teleop_enable(0)
    command.wait_complete()
    command.unhome(-1)
    wait("unhome", lambda: not any(status.homed[: status.joints]))


def teleop(on):
    mode("manual")
    command.teleop_enable(1 if on else 0)
    command.wait_complete()


def mdi(text, seconds=60.0):
    mode("mdi")
    command.mdi(text)
    command.wait_complete(seconds)
    wait(
        text,
        lambda: status.inpos and status.interp_state == linuxcnc.INTERP_IDLE,
        seconds,
    )


def begin_mdi(text):
    mode("mdi")
    command.mdi(text)


def begin(program):
    mode("auto")
    command.program_open(program)
    command.auto(linuxcnc.AUTO_RUN, 0)
    wait("program", lambda: status.interp_state != linuxcnc.INTERP_IDLE)


def busy():
    status.poll()
    message = errors.poll()
    # Plain messages are not errors.
    if message and message[0] in (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR):
        raise RuntimeError(f"LinuxCNC says: {message[1]}")
    if status.task_state != linuxcnc.STATE_ON:
        raise RuntimeError("LinuxCNC has switched the machine off")
    return status.interp_state != linuxcnc.INTERP_IDLE or not status.inpos


def stopped():
    """Whether the program waits for the operator (M0)."""
    status.poll()
    return status.interp_state == linuxcnc.INTERP_PAUSED and status.inpos


def pause():
    command.auto(linuxcnc.AUTO_PAUSE)
    command.wait_complete()


def idle(seconds=60.0):
    """Waits until nothing moves and the interpreter has nothing to do."""
    command.wait_complete(seconds)
    wait(
        "idle",
        lambda: status.inpos and status.interp_state == linuxcnc.INTERP_IDLE,
        seconds,
    )


def overrides(feed, rapid):
    command.feedrate(feed)
    command.wait_complete()
    command.rapidrate(rapid)
    command.wait_complete()


def resume():
    command.auto(linuxcnc.AUTO_RESUME)
    wait("resume", lambda: status.interp_state != linuxcnc.INTERP_PAUSED)


def abort():
    command.abort()
    command.wait_complete()


def pins(names):
    return [hal.get_value(name) for name in names]


def setp(name, value):
    hal.set_p(name, str(value))


def mark(scenario):
    component["scenario"] = scenario


def zero(on):
    component["zero"] = bool(on)


def halcmd(words):
    # Into a file: a program that is loaded keeps what it inherits, so a pipe would never end.
    with tempfile.TemporaryFile("w+") as said_there:
        done = subprocess.run(
            ["halcmd", *words],
            stdout=said_there,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            timeout=30,
        )
        said_there.seek(0)
        text = said_there.read()
    if done.returncode:
        raise RuntimeError(f"halcmd {words}: {text}")
    return text


def version():
    return linuxcnc.version


def stat():
    status.poll()
    return {
        "task_state": status.task_state,
        "motion_mode": status.motion_mode,
        "position": status.position[:3],
        "g5x": status.g5x_offset[:3],
        "gcodes": status.gcodes[1:],
        "settings": status.settings[1:3],
        "probed": status.probed_position[:3],
        "said": said(),
    }


VERBS = {
    function.__name__: function
    for function in (
        *(state, mode, begin_home, home, unhome, teleop, jog),
        *(mdi, begin_mdi, begin, busy, stopped, pause, resume, abort),
        *(idle, overrides, pins, setp, mark, zero, halcmd, stat, version),
    )
}


def main():
    line = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
    with line, line.makefile("rw", encoding="utf-8") as stream:
        for request in stream:
            asked = json.loads(request)
            try:
                answer = {"ok": VERBS[asked.pop("do")](**asked)}
            except Exception as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            stream.write(json.dumps(answer) + "\n")
            stream.flush()


main()
