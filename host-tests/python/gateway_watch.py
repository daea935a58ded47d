"""What a PLC has of a bridge whose offsets change every millisecond, and how old it is when it comes: OffsetZ is the
bridge's clock in ms, OffsetX is minus that, OffsetY the same. A block whose CRC is wrong, or whose three offsets are not
of one millisecond, is half old.

`s7`: the data block in python-snap7's server, looked at all the time; prints its port first. `modbus PORT`: pymodbus
over TCP, a hundred reads a second. `rtu BAUD`: pymodbus on a pseudo terminal, as often as the line permits; prints the
gateway's end of it first. Bytes are handed on when they would have come at that speed, by a process of their own (`wire`):
pymodbus looks for bytes without a pause, and a thread beside it would wait for the interpreter.

At the end of its input it prints one line of JSON, but not before --polls have been.
"""

import argparse
import binascii
import json
import os
import pty
import struct
import subprocess
import sys
import threading
import time
import tty

from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from s7_server import BLOCK_BYTES, INPUT_BYTES, free_port, serve

INPUT_ID, INPUT_REGISTERS = 0x0181, INPUT_BYTES // 2
CLOCK_MS = 500_000
NOT_AVAILABLE = -(2**31)
# Between two looks at a data block, and two reads by Modbus.
LOOK_S, PERIOD_S = 0.0003, 0.01
PATIENCE_S = 5
BITS = 11


class Seen:
    """The blocks that came."""

    def __init__(self):
        self.polls, self.half_old, self.last, self.ages = 0, 0, bytes(INPUT_BYTES), []

    def take(self, block):
        now = time.time() * 1000
        self.polls += 1
        if block == self.last:
            return
        self.last = block
        x, y, z = struct.unpack_from(">3i", block, 4)
        told = struct.pack(">H", binascii.crc_hqx(block[:-2] + struct.pack("<H", INPUT_ID), 0xFFFF))
        if told != block[-2:]:
            self.half_old += 1
        elif z != NOT_AVAILABLE:
            self.half_old += (x, y) != (-z, z)
            self.ages.append((now - z) % CLOCK_MS)

    def summary(self):
        ages = sorted(self.ages)
        at = lambda share: round(ages[min(len(ages) - 1, int(share * len(ages)))], 2)
        return {
            "polls": self.polls, "blocks": len(ages), "half_old": self.half_old,
            "p50_ms": at(0.5), "p99_ms": at(0.99), "max_ms": at(1),
        }


def by_modbus(client, seen):
    started = time.monotonic()
    answer = client.read_input_registers(0, count=INPUT_REGISTERS, device_id=1)
    seen.take(struct.pack(f">{INPUT_REGISTERS}H", *answer.registers))
    time.sleep(max(0.0, PERIOD_S - (time.monotonic() - started)))


def hand_on(one, other, baud):
    while data := os.read(one, 512):
        time.sleep(len(data) * BITS / baud)
        os.write(other, data)


def wire(baud):
    """Two pseudo terminals with a wire between them, until the end of the input; prints their names."""
    (ours, gateway_end), (theirs, master_end) = pty.openpty(), pty.openpty()
    for end in (ours, gateway_end, theirs, master_end):
        tty.setraw(end)
    for pair in ((ours, theirs), (theirs, ours)):
        threading.Thread(target=hand_on, args=(*pair, baud), daemon=True).start()
    print(json.dumps({"gateway": os.ttyname(gateway_end), "master": os.ttyname(master_end)}), flush=True)
    sys.stdin.read()


def serial_line(baud):
    """The master's end of a line; prints the other. Its process ends with this one, whose end of the pipe is closed."""
    process = subprocess.Popen(
        [sys.executable, __file__, "wire", str(baud)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    ends = json.loads(process.stdout.readline())
    print(json.dumps({"device": ends["gateway"]}), flush=True)
    return process, ends["master"]


def look(kind, number):
    """What looks once."""
    if kind == "s7":
        block, port = bytearray(BLOCK_BYTES), free_port()
        server = serve(port, block)
        print(json.dumps({"port": port}), flush=True)

        def look(seen):
            assert server
            seen.take(bytes(block[:INPUT_BYTES]))
            time.sleep(LOOK_S)

        return look
    if kind == "modbus":
        client = ModbusTcpClient("127.0.0.1", port=number, timeout=PATIENCE_S, retries=0)
        print(json.dumps({"connected": client.connect()}), flush=True)
    else:
        process, device = serial_line(number)
        client = ModbusSerialClient(device, baudrate=number, stopbits=2, timeout=PATIENCE_S, retries=3)
        # As long as it asks.
        client.wire = process
        sys.stdin.readline()
        client.connect()
    return lambda seen: by_modbus(client, seen)


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("kind", choices=["s7", "modbus", "rtu", "wire"])
    arguments.add_argument("number", type=int, nargs="?", default=0)
    arguments.add_argument("--polls", type=int, default=0)
    arguments = arguments.parse_args()
    if arguments.kind == "wire":
        wire(arguments.number)
        return
    once, seen = look(arguments.kind, arguments.number), Seen()
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    while not ended.is_set() or seen.polls < arguments.polls:
        once(seen)
    print(json.dumps(seen.summary()), flush=True)


main()
