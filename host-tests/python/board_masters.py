"""Masters of other people, pymodbus and mbpoll, on the RS-485 line of the flashable image: a pseudo terminal, with a
wire to the TCP port that the model of the chip has for it. Prints what they saw as one line of JSON.

The board is slower than life, so every patience is long; between two requests the line is silent as the standard asks.
"""

import argparse
import json
import os
import pty
import socket
import struct
import subprocess
import threading
import time
import tty

from pymodbus.client import ModbusSerialClient

from modbus_master import ENGAGE, INPUT_REGISTERS, LIVE, REFERENCED, Plc, exception

PATIENCE_S = 100


def checksum(frame):
    value = 0xFFFF
    for byte in frame:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return frame + struct.pack("<H", value)


class Rtu(Plc):
    """The PLC of the other session, on a serial line."""

    def __init__(self, device):
        self.client = ModbusSerialClient(device, baudrate=19200, stopbits=2, timeout=PATIENCE_S, retries=0)
        if not self.client.connect():
            raise SystemExit("no line")
        self.counter = 0
        self.wrong = []


def wire(line, terminal):
    def up():
        while data := os.read(terminal, 512):
            line.sendall(data)

    threading.Thread(target=up, daemon=True).start()
    while data := line.recv(512):
        os.write(terminal, data)


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("port", type=int)
    arguments.add_argument("mbpoll")
    arguments = arguments.parse_args()
    ours, theirs = pty.openpty()
    for end in (ours, theirs):
        tty.setraw(end)
    line = socket.create_connection(("127.0.0.1", arguments.port))
    threading.Thread(target=wire, args=(line, ours), daemon=True).start()
    plc = Rtu(os.ttyname(theirs))
    client, saw = plc.client, {}
    for _ in range(4):
        plc.write(REFERENCED)
    saw["released"] = plc.read()
    last = [0]

    def has_settled(said):
        last.append(said["offset_um"][2] or 0.0)
        return said["quality"] == LIVE and abs(last[-1] - last[-2]) < 0.1 and last[-1] > 1

    saw["live"] = plc.live_until(ENGAGE | REFERENCED, has_settled)
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
    plc.write(0, counter=(plc.counter + 1) & 0xFFFF, damage=True)
    plc.write(0, counter=plc.counter)
    # To everybody, to another unit, with a wrong checksum, noise, half a request: nobody answers and nothing moves.
    write = struct.pack(">BHHB", 16, 0, len(part), 2 * len(part)) + struct.pack(f">{len(part)}H", *plc.block(0))
    whole = checksum(b"\1" + write)
    silent = [checksum(b"\0" + write), checksum(b"\7" + write), whole[:-1] + b"?", bytes(range(200, 250)), whole[:9]]
    for frame in silent:
        line.sendall(frame)
        # Longer than the frame and its silence take on the board, however slow it is.
        time.sleep(2)
    plc.write(ENGAGE | REFERENCED)
    saw["after faults"] = plc.live_until(ENGAGE | REFERENCED, lambda said: said["quality"] == LIVE)
    saw["wrong"], saw["registers"] = plc.wrong, INPUT_REGISTERS
    client.close()
    poll = [arguments.mbpoll, "-m", "rtu", "-b", "19200", "-P", "none", "-s", "2", "-o", "10", "-t", "3:int", "-B", "-0"]
    saw["mbpoll"] = subprocess.run(
        [*poll, "-r", "2", "-c", "3", "-1", os.ttyname(theirs)], capture_output=True, text=True, timeout=PATIENCE_S
    ).stdout
    print(json.dumps(saw))


main()
