"""Tool and conditions by way of the PLC program of integrations/siemens-840d in awlsim, its clock by hand: prints the holding
block of DB 900, 40 bytes in hexadecimal, after cycles with these words in the flags of the example.
"""

import json
import struct

from s7_plc import HOLDING_AT, Cpu

PRESENT, TOOL, CONDITIONS = 116, 220, 222


def main():
    plc = Cpu()
    blocks = []
    for present, tool, conditions in [(0x10, 0, 0), (0x30, 7, 0x8200), (0x30, 65_535, 0), (0x10, 7, 1)]:
        for at, word in [(PRESENT, present), (TOOL, tool), (CONDITIONS, conditions)]:
            struct.pack_into(">H", plc.flags, at, word)
        plc.cpu.runCycle()
        plc.set_bit("restart", False)
        blocks.append(bytes(plc.block[HOLDING_AT : HOLDING_AT + 40]).hex())
    print(json.dumps(blocks))


if __name__ == "__main__":
    main()
