"""An 840D's PLC made of other people's code: python-snap7's server has the data block, awlsim runs the PLC
program of integrations/siemens-840d against a stub of the NCK.

Prints its port, then one line of JSON a cycle. Reads orders, one line of JSON each, from standard input:
{"set": {"enable": true}}, {"stop": true} and {"start": true} of the CPU, {"damage": N} bits of the next N blocks,
{"swap": true} offsets X and Z in what the program sees, {"replay": N} cycles of an old block, {"freeze": true} the
block, {"write_cycles": N} a write lasts, {"fail": true} writes, {"never": true} ends one, {"cut": true} and
{"join": true} the network. At the end of its input it ends.
"""

import argparse
import json
import queue
import random
import struct
import sys
import threading
import time
from pathlib import Path

# The CPU first: awlsim's parser needs it.
from awlsim.core.cpu import S7CPU
from awlsim.core.memory import AwlMemoryObject_asScalar
from awlsim.awlcompiler.tokenizer import AwlParser

from s7_server import BLOCK_BYTES, HOLDING_AT, INPUT_BYTES, free_port, serve

INSTANCE_DB = 901
BITS = {"enable": 0, "ready": 1, "restart": 2, "zero": 3, "service": 4, "confirm": 5}
HERE = Path(__file__).parent
PROGRAM = HERE.parents[1] / "integrations/siemens-840d"
SOURCES = ["trueup_db", "trueup_crc", "trueup_step", "trueup_fb"]
CALLS = {False: "trueup_ob1", True: "trueup_ob1_slope"}


class Cpu:
    """The program in awlsim, with its flags and its data blocks as bytes."""

    def __init__(self, slopes=False):
        self.cpu = S7CPU()
        for path in [*(PROGRAM / f"{name}.awl" for name in [*SOURCES, CALLS[slopes]]), HERE / "nck_stub.awl"]:
            parser = AwlParser()
            parser.parseText(path.read_text())
            self.cpu.load(parser.getParseTree())
        self.cpu.build()
        # A busy computer is no fault of the program.
        self.cpu.setCycleTimeLimit(60.0)
        self.cpu.startup()
        self.flags = self.cpu.flags.getDataBytes()
        self.block = self.cpu.getDB(900).structInstance.memory.getDataBytes()
        self.instance = self.cpu.getDB(INSTANCE_DB)
        self.set_bit("ready", True)
        self.set_bit("restart", True)
        self.word(102, 10)
        self.word(160, 2)

    def word(self, at, value=None):
        if value is None:
            return struct.unpack_from(">h", self.flags, at)[0]
        struct.pack_into(">h", self.flags, at, value)

    def real(self, at, value=None):
        if value is None:
            return struct.unpack_from(">f", self.flags, at)[0]
        struct.pack_into(">f", self.flags, at, value)

    def set_bit(self, name, value):
        bit = 1 << BITS[name]
        self.flags[100] = self.flags[100] | bit if value else self.flags[100] & ~bit

    def number(self, name):
        """A variable of the program's instance: BOOL or INT."""
        field = self.instance.structInstance.getFieldDataByName(name)
        raw = AwlMemoryObject_asScalar(field)
        return bool(raw) if field.width == 1 else raw - ((raw & 0x8000) << 1)


def listen(lines):
    for line in sys.stdin:
        lines.put(json.loads(line))
    lines.put(None)


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cycle-ms", type=int, default=50)
    arguments.add_argument("--block-alone", action="store_true", help="no program: the data block alone")
    arguments = arguments.parse_args()
    port = free_port()
    shared = bytearray(BLOCK_BYTES)
    random.seed(1)
    server = serve(port, shared)
    print(json.dumps({"port": port}), flush=True)
    if arguments.block_alone:
        sys.stdin.read()
        return
    plc = Cpu()
    orders = queue.Queue()
    threading.Thread(target=listen, args=[orders], daemon=True).start()
    runs, frozen, swaps = True, None, False
    damage = replay = 0
    old = bytes(INPUT_BYTES)
    last = time.monotonic()
    while True:
        while not orders.empty():
            order = orders.get()
            if order is None:
                server.stop()
                return
            for name, value in order.get("set", {}).items():
                plc.set_bit(name, value)
            if "stop" in order:
                runs = False
            if "start" in order:
                runs = True
                last = time.monotonic()
                plc.set_bit("restart", True)
                # The basic program's GET has read the setting data back.
                for n in range(3):
                    plc.real(104 + 4 * n, plc.real(170 + 4 * n))
            damage = order.get("damage", damage)
            replay = order.get("replay", replay)
            swaps = order.get("swap", swaps)
            if "freeze" in order:
                frozen = bytes(shared[:INPUT_BYTES]) if order["freeze"] else None
            if "write_cycles" in order:
                plc.word(160, order["write_cycles"])
            for name, bit in [("fail", 1), ("never", 2)]:
                if name in order:
                    plc.flags[162] = plc.flags[162] | bit if order[name] else plc.flags[162] & ~bit
            if "cut" in order:
                server.stop()
            if "join" in order:
                server = serve(port, shared)
        now = time.monotonic()
        if runs:
            block = bytearray(frozen or shared[:INPUT_BYTES])
            if replay:
                block, replay = bytearray(old), replay - 1
            elif random.random() < 0.05:
                old = bytes(block)
            if swaps:
                block[4:8], block[12:16] = block[12:16], block[4:8]
            if damage:
                bit, damage = random.randrange(8 * INPUT_BYTES), damage - 1
                block[bit // 8] ^= 1 << bit % 8
            plc.block[:INPUT_BYTES] = block
            plc.word(102, max(1, min(1000, round((now - last) * 1000))))
            plc.cpu.runCycle()
            plc.set_bit("restart", False)
            shared[HOLDING_AT:] = plc.block[HOLDING_AT:BLOCK_BYTES]
            last = now
        said = {
            "t_s": round(now, 4),
            "runs": runs,
            "nck_mm": [plc.real(at) for at in (170, 174, 178)],
            "writes": plc.word(164),
            "state": plc.number("STATE"),
            "fault": plc.number("FAULT"),
            "engaged": plc.number("ENGAGED"),
            "rejected": plc.number("REJECTED"),
        }
        print(json.dumps(said), flush=True)
        time.sleep(max(0.0, arguments.cycle_ms / 1000 - (time.monotonic() - now)))


if __name__ == "__main__":
    main()
