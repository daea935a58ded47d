"""A PLC made of other people's code: pymodbus against `trueup gateway modbus`. It plays one session and
prints what it saw as JSON.

The session: read the block; engage and wait until the offset has settled; read it again; then every fault
that a master can commit; then be a second master; then fall silent and watch the offset go back.
"""

import argparse
import json
import struct
import time

from pymodbus import ModbusException
from pymodbus.client import ModbusTcpClient

INPUT_REGISTERS, HOLDING_REGISTERS = 28, 17
INPUT_ID, HOLDING_ID, CONDITIONS_ID = 0x0181, 0x0302, 0x0402
ENGAGE, REFERENCED = 1, 2
OFF, LIVE, HOLD, RAMPING_OUT, FAULT = 0, 1, 4, 5, 6
PATIENCE_S = 60.0
PERIOD_S = 0.02


def crc(registers, data_id):
    """The documentation's arithmetic, bit by bit."""
    value = 0xFFFF
    for byte in struct.pack(f">{len(registers)}H", *registers) + struct.pack("<H", data_id):
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


class Plc:
    def __init__(self, host, port):
        self.client = ModbusTcpClient(host, port=port, timeout=3, retries=0)
        if not self.client.connect():
            raise SystemExit("nobody listens")
        self.counter = 0
        self.wrong = []

    def read(self):
        answer = self.client.read_input_registers(0, count=INPUT_REGISTERS, device_id=1)
        block = answer.registers
        if crc(block[:-1], INPUT_ID) != block[-1] or block[0] != 1:
            self.wrong.append(block)
        raw = struct.pack(f">{len(block)}H", *block)
        x, y, z = struct.unpack(">3i", raw[4:16])
        return {
            "counter": block[1],
            "offset_um": [None if it == -(2**31) else it / 100 for it in (x, y, z)],
            "quality": block[8],
            "flags": block[9],
            "age_ms": block[10],
            "last_refused": block[11],
            "refused": block[12],
            "state": struct.unpack(">I", raw[26:30])[0],
            "calibration": struct.unpack(">I", raw[30:34])[0],
            "elongation_um": struct.unpack(">i", raw[34:38])[0] / 1000,
            "temps_c": [it / 100 for it in struct.unpack(">8h", raw[38:54])],
        }

    def block(self, control, counter=None, damage=False, conditions=None):
        """17 registers, or 20 with tool and conditions."""
        if counter is None:
            self.counter = (self.counter + 1) & 0xFFFF
            counter = self.counter
        words = [counter, control, 0b10000, 0] + [0] * 10 + [24000, 0]
        if conditions is None:
            return words + [crc(words, HOLDING_ID) ^ damage]
        words[2] |= 0b100000
        words += [crc(words, HOLDING_ID), *conditions]
        return words + [crc(words, CONDITIONS_ID) ^ damage]

    def write(self, control, **how):
        return self.client.write_registers(0, self.block(control, **how), device_id=1)

    def live_until(self, control, wanted, **how):
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            self.write(control, **how)
            said = self.read()
            if wanted(said):
                return said
            time.sleep(PERIOD_S)
        raise SystemExit(f"never came: {said}")


def exception(answer):
    return answer.exception_code if answer.isError() else None


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("host")
    arguments.add_argument("port", type=int)
    arguments = arguments.parse_args()
    plc = Plc(arguments.host, arguments.port)
    saw = {}
    # Each item of its status has come, and 200 ms without Engage, then engaged until the offset stands.
    time.sleep(1.3)
    for _ in range(10):
        plc.write(REFERENCED)
        time.sleep(PERIOD_S)
    saw["released"] = plc.read()
    last = [0]

    def has_settled(said):
        z = said["offset_um"][2] or 0.0
        last.append(z)
        return said["quality"] == LIVE and len(last) > 40 and abs(z - last[-40]) < 0.1 and z > 1

    saw["live"] = plc.live_until(ENGAGE | REFERENCED, has_settled)
    # Faults, one after the other, the life sign between them.
    client = plc.client
    part = plc.block(0, counter=0)
    faults = {
        "coils": lambda: client.read_coils(0, count=8, device_id=1),
        "discrete inputs": lambda: client.read_discrete_inputs(0, count=8, device_id=1),
        "one register": lambda: client.write_register(1, 0, device_id=1),
        "read and write": lambda: client.readwrite_registers(
            read_address=0, read_count=1, write_address=0, values=[0], device_id=1
        ),
        "behind the end": lambda: client.read_input_registers(27, count=2, device_id=1),
        "a part": lambda: client.write_registers(0, part[:5], device_id=1),
        "elsewhere": lambda: client.write_registers(1, part, device_id=1),
        "another unit": lambda: client.read_input_registers(0, count=1, device_id=7),
    }
    saw["exceptions"] = {}
    before = plc.read()["refused"]
    for name, fault in faults.items():
        saw["exceptions"][name] = exception(fault())
        plc.write(ENGAGE | REFERENCED)
    saw["refused by faults"] = plc.read()["refused"] - before
    # Blocks that are acknowledged, not used, and counted.
    saw["acknowledged"] = [
        exception(plc.write(0, counter=(plc.counter + 1) & 0xFFFF, damage=True)),
        exception(plc.write(0, counter=plc.counter)),
        exception(plc.write(0, counter=(plc.counter + 900) & 0xFFFF)),
    ]
    time.sleep(0.05)
    saw["after faults"] = plc.read()
    plc.counter = (plc.counter + 900) & 0xFFFF
    plc.live_until(ENGAGE | REFERENCED, lambda said: said["quality"] == LIVE)
    # A broadcast has no answer, and moves nothing.
    client.write_registers(0, plc.block(0), device_id=0, no_response_expected=True)
    saw["after broadcast"] = plc.live_until(ENGAGE | REFERENCED, lambda said: True)
    # Another master reads, but may not write.
    other = Plc(arguments.host, arguments.port)
    saw["second master"] = exception(other.write(0))
    time.sleep(0.05)
    plc.write(ENGAGE | REFERENCED)
    saw["second master is told"] = other.read()["state"] >> 5 & 1
    # The PLC falls silent: the bridge holds, then takes the offset back.
    course, end = [], time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        said = other.read()
        if not course or course[-1] != [said["quality"], said["offset_um"][2]]:
            course.append([said["quality"], said["offset_um"][2]])
        if said["quality"] == OFF:
            break
        time.sleep(0.001)
    qualities = [quality for quality, _ in course]
    saw["silent"] = [it for n, it in enumerate(qualities) if n == 0 or qualities[n - 1] != it]
    ramp = [z for quality, z in course if quality == RAMPING_OUT]
    saw["ramp turns back"] = any(after > before for before, after in zip(ramp, ramp[1:]))
    saw["silent at the end"] = course[-1]
    saw["wrong"] = plc.wrong + other.wrong
    print(json.dumps(saw))


if __name__ == "__main__":
    try:
        main()
    except ModbusException as error:
        raise SystemExit(f"pymodbus: {error}")
