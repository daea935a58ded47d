"""Masters of other people on the RS-485 line of the flashable image: pymodbus, then mbpoll, or LinuxCNC's mb2hal. Prints
what they saw as one line of JSON.

The line is a pseudo terminal, with a wire to the TCP port that the model of the chip has for it. The board is slower
than life, and how much so goes with what else the computer does: every patience is long, and what a master sends in
pieces is handed on in one, since the model tells the end of a frame by silences of its own time. A request that comes
before the board has started is lost, as on a wire of copper, and asked again. A pseudo terminal refuses parity, so the
board's switch is at none, two stop bits.
"""

import argparse
import json
import os
import pty
import re
import select
import socket
import subprocess
import tempfile
import threading
import time
import tty
from pathlib import Path

from pymodbus import ModbusException
from pymodbus.client import ModbusSerialClient

from modbus_master import ENGAGE, INPUT_ID, INPUT_REGISTERS, LIVE, REFERENCED, Plc, crc, exception

# Of one answer, of the start, and of the whole session.
ANSWER_S, START_S, PATIENCE_S = 20, 60, 120
# A request is whole when nothing more has come for so long.
PIECES_S = 0.01
# The longest that mbpoll and mb2hal are told to wait.
MBPOLL_S, MB2HAL_MS = "10", "10000"


def wire(line, terminal):
    """Both ways until the end of the process."""

    def up():
        while data := os.read(terminal, 512):
            while select.select([terminal], [], [], PIECES_S)[0]:
                data += os.read(terminal, 512)
            line.sendall(data)

    threading.Thread(target=up, daemon=True).start()
    while data := line.recv(512):
        os.write(terminal, data)


class Rtu(Plc):
    """The PLC of the session over TCP, on a serial line."""

    def __init__(self, device, timeout=ANSWER_S):
        self.client = ModbusSerialClient(device, baudrate=19200, stopbits=2, timeout=timeout, retries=0)
        if not self.client.connect():
            raise SystemExit("no line")
        self.counter = 0
        self.wrong = []


def started(device):
    """Waits for the first answer."""
    plc = Rtu(device, timeout=2)
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        try:
            return plc.read()
        except ModbusException:
            pass  # it has not started
        finally:
            plc.client.close()
        plc.client.connect()
    raise SystemExit("the board never answered")


def session(plc):
    """Reads, engages, and does what a master can do wrong by pymodbus."""
    client, saw = plc.client, {}
    for _ in range(4):
        plc.write(REFERENCED)
    saw["released"] = plc.read()
    last = [0.0]

    def has_settled(said):
        last.append(said["offset_um"][2] or 0.0)
        return said["quality"] == LIVE and abs(last[-1] - last[-2]) < 0.1 and last[-1] > 1

    end = time.monotonic() + PATIENCE_S
    said = saw["released"]
    while not has_settled(said):
        if time.monotonic() > end:
            raise SystemExit(f"never settled: {said}")
        plc.write(ENGAGE | REFERENCED)
        said = plc.read()
    saw["live"] = said
    part = plc.block(0, counter=0)
    faults = {
        "coils": lambda: client.read_coils(0, count=8, device_id=1),
        "one register": lambda: client.write_register(1, 0, device_id=1),
        "behind the end": lambda: client.read_input_registers(27, count=2, device_id=1),
        "a part": lambda: client.write_registers(0, part[:5], device_id=1),
        "elsewhere": lambda: client.write_registers(1, part, device_id=1),
    }
    saw["exceptions"] = {}
    for name, fault in faults.items():
        saw["exceptions"][name] = exception(fault())
        plc.write(ENGAGE | REFERENCED)
    # Acknowledged, not used, counted.
    saw["acknowledged"] = [
        exception(plc.write(0, counter=(plc.counter + 1) & 0xFFFF, damage=True)),
        exception(plc.write(0, counter=plc.counter)),
    ]
    plc.write(ENGAGE | REFERENCED)
    saw["after faults"] = plc.read()
    saw["wrong"] = plc.wrong
    return saw


def is_whole(registers):
    return len(registers) == INPUT_REGISTERS and crc(registers[:-1], INPUT_ID) == registers[-1]


def by_mbpoll(program, device):
    """The whole block, register by register."""
    line = ["-m", "rtu", "-b", "19200", "-P", "none", "-s", "2", "-o", MBPOLL_S]
    said = subprocess.run(
        [program, *line, "-t", "3", "-0", "-r", "0", "-c", str(INPUT_REGISTERS), "-1", device],
        capture_output=True, text=True, timeout=PATIENCE_S,
    ).stdout
    # A register above 32767 has its signed value in brackets behind it.
    return [int(it) for it in re.findall(r"^\[\d+\]:\s+(-?\d+)", said, re.MULTILINE)]


def by_mb2hal(sample, device):
    """The pins, with the sample that is delivered; its line, and its patience with a board that is slow, are changed."""
    here = Path(sample).read_text()
    changes = {"SERIAL_PORT": device, "SERIAL_PARITY": "none", "SERIAL_STOP": 2}
    for key, value in (changes | dict.fromkeys(["MB_RESPONSE_TIMEOUT_MS", "MB_BYTE_TIMEOUT_MS"], MB2HAL_MS)).items():
        here, count = re.subn(rf"^{key}=.*$", f"{key}={value}", here, flags=re.MULTILINE)
        if count != 1:
            raise SystemExit(f"the sample has {count} of {key}")
    with tempfile.TemporaryDirectory() as folder:
        ini, hal = Path(folder) / "mb2hal.ini", Path(folder) / "read.hal"
        ini.write_text(here)
        hal.write_text(f"loadusr -Wn trueup-board mb2hal config={ini}\nloadusr -w sleep 6\nshow pin\n")
        said = subprocess.run(
            ["halrun", "-f", str(hal)], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE_S
        ).stdout
    # Owner, type, direction, value, name.
    pins = re.findall(r"^\s*\d+\s+s32\s+OUT\s+(-?\d+)\s+trueup-board\.input\.(\d+)\.int", said, re.MULTILINE)
    return [int(value) for value, _ in sorted(pins, key=lambda pin: int(pin[1]))]


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("port", type=int)
    arguments.add_argument("mbpoll")
    arguments.add_argument("--mb2hal", metavar="INI", help="mb2hal in the place of the others")
    arguments = arguments.parse_args()
    ours, theirs = pty.openpty()
    for end in (ours, theirs):
        tty.setraw(end)
    line = socket.create_connection(("127.0.0.1", arguments.port))
    threading.Thread(target=wire, args=(line, ours), daemon=True).start()
    device = os.ttyname(theirs)
    started(device)
    if arguments.mb2hal:
        registers = by_mb2hal(arguments.mb2hal, device)
        print(json.dumps({"mb2hal": registers, "mb2hal is whole": is_whole(registers)}))
        return
    plc = Rtu(device)
    saw = session(plc)
    plc.client.close()
    registers = by_mbpoll(arguments.mbpoll, device)
    print(json.dumps(saw | {"mbpoll": registers, "mbpoll is whole": is_whole(registers)}))


try:
    main()
except ModbusException as error:
    raise SystemExit(f"pymodbus: {error}")
