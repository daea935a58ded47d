"""A PLC made of other people's code that says tool and conditions: pymodbus against `trueup gateway modbus`. It engages,
then says one tool after the other, and prints what it saw as JSON.
"""

import json
import sys
import time

from modbus_master import ENGAGE, HOLDING_REGISTERS, LIVE, PERIOD_S, REFERENCED, Plc, exception

ON = ENGAGE | REFERENCED
SETTLED_UM = 0.1
# The registers behind the block: tool, conditions.
SAID = {"tool 7": (7, 0), "tool 12": (12, 0), "another tool": (9, 0), "no tool, coolant": (0, 1 << 9)}


def main():
    plc = Plc(sys.argv[1], int(sys.argv[2]))
    time.sleep(1.3)
    saw = {}
    for _ in range(10):
        plc.write(REFERENCED, conditions=(0, 0))
        time.sleep(PERIOD_S)
    for name, conditions in SAID.items():
        last = [None] * 40

        def has_settled(said):
            last.append(said["offset_um"])
            before, now = last[-40], last[-1]
            is_still = before is not None and all(abs(a - b) < SETTLED_UM for a, b in zip(before, now))
            # The state comes in turn with the other items of the status: it may be of the time before.
            return said["quality"] == LIVE and said["state"] == 0 and is_still

        # A frame of it goes out at most every 50 ms.
        end = time.monotonic() + 0.3
        saw[name] = plc.live_until(ON, lambda said: time.monotonic() > end and has_settled(said), conditions=conditions)
    held = plc.client.read_holding_registers(0, count=20, device_id=1).registers
    saw["read back"] = held[HOLDING_REGISTERS : HOLDING_REGISTERS + 2]
    # Registers of another block: acknowledged and not used.
    saw["damaged"] = exception(plc.write(ON, conditions=(7, 0), damage=True))
    plc.write(ON, conditions=SAID["no tool, coolant"])
    time.sleep(0.05)
    saw["after"] = plc.read()
    saw["19 registers"] = exception(plc.client.write_registers(0, plc.block(ON, conditions=(7, 0))[:19], device_id=1))
    saw["wrong"] = plc.wrong
    print(json.dumps(saw))


if __name__ == "__main__":
    main()
