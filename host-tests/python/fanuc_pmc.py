"""The ladder of integrations/fanuc in an interpreter of its mnemonics, its clock by hand, against a stub of the control's
external data input. What the instructions do is from FANUC's description of them, not from a PMC. Prints what it saw as
one line of JSON: the shift that the control has got, with steps, holds, faults and the blocks that go back.
"""

import json
import random
import struct
from pathlib import Path

from s7_cuts import block

PROGRAM = Path(__file__).parents[2] / "integrations/fanuc/trueup_pmc.txt"
CYCLE_MS, SLEW, MAX_UM = 32, 20, 50
EA = [0x31, 0x32, 0x33]
FORMATS = {1: "b", 2: "<h", 4: "<i"}


class Pmc:
    def __init__(self, text):
        self.memory = {area: bytearray(10_000) for area in "RDGF"}
        self.code, self.labels, self.programs = [], {}, {}
        for line in text.splitlines():
            words = line.split(";")[0].split()
            if words:
                if words[:3:2] == ["SUB", "LBL"]:
                    self.labels[words[3]] = len(self.code)
                if words[:3:2] == ["SUB", "SP"]:
                    self.programs[words[3]] = len(self.code)
                self.code.append(words)
        # Always off, always on.
        self.memory["R"][9091] = 0b10

    def bit(self, address, value=None):
        byte, bit = address[1:].split(".")
        area, at, mask = self.memory[address[0]], int(byte), 1 << int(bit)
        if value is not None:
            area[at] = area[at] | mask if value else area[at] & ~mask
        return bool(area[at] & mask)

    def number(self, address, length, value=None):
        area, at = self.memory[address[0]], int(address[1:])
        if value is not None:
            # A result that does not fit is an error output of the instruction: here it ends the test.
            struct.pack_into(FORMATS[length], area, at, value)
        return struct.unpack_from(FORMATS[length], area, at)[0]

    def operand(self, form, text):
        return self.number(text, int(form[3])) if form[0] == "1" else int(text)

    def scan(self):
        at, stack, calls, steps = 0, [], [], 0
        while True:
            steps += 1
            assert steps < 100_000, "it does not end"
            name, *rest = self.code[at]
            at += 1
            if name in ("RD", "RD.NOT"):
                stack = [self.bit(rest[0]) ^ name.endswith("NOT")]
            elif name == "RD.STK":
                stack.append(self.bit(rest[0]))
            elif name in ("AND", "AND.NOT"):
                stack[-1] &= self.bit(rest[0]) ^ name.endswith("NOT")
            elif name in ("OR", "OR.NOT"):
                stack[-1] |= self.bit(rest[0]) ^ name.endswith("NOT")
            elif name == "WRT":
                self.bit(rest[0], stack[-1])
            elif name in ("SET", "RST"):
                if stack[-1]:
                    self.bit(rest[0], name == "SET")
            elif rest[1] in ("END", "END2"):
                return steps
            elif rest[1] == "SPE":
                at = calls.pop()
            elif rest[1] in ("END1", "LBL", "SP"):
                pass
            elif stack[-1]:
                at = self.function(rest[1], rest[2:], at, calls)

    def function(self, name, rest, at, calls):
        if name == "JMPB":
            assert self.labels[rest[0]] >= at, "no jump goes back"
            return self.labels[rest[0]]
        if name == "CALL":
            calls.append(at)
            return self.programs[rest[0]]
        if name == "NUMEB":
            self.number(rest[2], int(rest[0][3]), int(rest[1]))
        elif name in ("MOVB", "MOVW", "MOVD"):
            length = {"MOVB": 1, "MOVW": 2, "MOVD": 4}[name]
            self.number(rest[1], length, self.number(rest[0], length))
        elif name == "MOVN":
            length, source, goal = int(rest[0]), rest[1], rest[2]
            data = self.memory[source[0]][int(source[1:]) : int(source[1:]) + length]
            self.memory[goal[0]][int(goal[1:]) : int(goal[1:]) + length] = data
        elif name == "COMPB":
            a, b = self.operand(rest[0], rest[1]), self.number(rest[2], int(rest[0][3]))
            self.bit("R9000.0", a == b)
            self.bit("R9000.1", a < b)
        else:
            length = int(rest[0][3])
            a, b = self.number(rest[1], length), self.operand(rest[0], rest[2])
            result = {
                "ADDB": lambda: a + b, "SUBB": lambda: a - b, "MULB": lambda: a * b,
                "DIVB": lambda: abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1),
                "EOR": lambda: a ^ b, "AND": lambda: a & b, "OR": lambda: a | b,
            }[name]()
            self.number(rest[3], length, result)
        return at


class Machine:
    """The program, its signals, and the control that reads a value some scans after the strobe."""

    def __init__(self):
        self.pmc = Pmc(PROGRAM.read_text())
        self.shift_um, self.slow, self.dead, self.strobed, self.old = {}, 2, False, 0, False
        self.now_ms, self.writes = 0, []
        set_word = lambda at, value: self.pmc.number(f"D{at}", 2, value)
        for at, value in [(1100, CYCLE_MS), (1102, SLEW), (1104, 200), (1106, 2000), *((1108 + 2 * n, MAX_UM) for n in range(3)),
                          (1114, 0x31), (1142, 7), (1144, 0x101)]:
            set_word(at, value)
        self.pmc.number("D1118", 4, -123_456)
        self.pmc.memory["D"][1150:1153] = bytes(EA)
        for bit in ("R101.2", "R100.0", "R100.1"):
            self.pmc.bit(bit, True)

    def give(self, data):
        """A block as the master between writes it: each register with its low byte first."""
        swapped = b"".join(data[n : n + 2][::-1] for n in range(0, 56, 2))
        self.pmc.memory["D"][900:956] = swapped

    def scan(self):
        self.now_ms += CYCLE_MS
        steps = self.pmc.scan()
        g, strobe = self.pmc.memory["G"], self.pmc.bit("G2.7")
        self.strobed = self.strobed + 1 if strobe else 0
        if strobe and self.strobed == self.slow and not self.dead:
            value = struct.unpack_from("<h", g, 0)[0]
            axis = EA.index(g[2] & 0x7F)
            self.writes.append((self.now_ms, axis, value - self.shift_um.get(axis, 0)))
            self.shift_um[axis] = value
            self.pmc.bit("F60.0", True)
        if not strobe:
            self.pmc.bit("F60.0", False)
        return steps

    def said(self):
        bits = {name: self.pmc.bit(at) for name, at in [("fault", "R101.0"), ("engaged", "R101.1")]}
        return bits | {"state": self.pmc.memory["R"][102], "shift_um": [self.shift_um.get(n, 0) for n in range(3)]}

    def holding(self):
        data = self.pmc.memory["D"][1000:1040]
        return b"".join(bytes(data[n : n + 2][::-1]) for n in range(0, 40, 2)).hex()


def main():
    random.seed(1)
    machine, counter, saw = Machine(), 0xFFF0, {}

    def run(seconds, shown):
        nonlocal counter
        for _ in range(round(1000 * seconds / CYCLE_MS)):
            counter += 1
            data = shown(counter)
            if data is not None:
                machine.give(data)
            saw["steps"] = max(saw.get("steps", 0), machine.scan())

    live = lambda counter: block(counter, 3_010, 1)
    run(0.15, lambda counter: block(counter, None, 6))
    saw["released"] = machine.said()
    run(0.3, lambda counter: block(counter, None, 6))
    saw["engages"] = machine.said()
    run(0.15, live)
    saw["first"] = machine.said()
    run(5, live)
    saw["there"] = machine.said()
    saw["holding"] = machine.holding()
    damaged = lambda counter: (lambda data: bytes([data[0], data[1] ^ 1, *data[2:]]))(bytearray(live(counter)))
    run(1, damaged)
    saw["damaged"] = machine.said()
    run(1, live)
    saw["again"] = machine.said()
    run(1.5, lambda counter: None)
    saw["held"] = machine.said()
    run(6, lambda counter: None)
    saw["back"] = machine.said()
    run(5, live)
    saw["engaged anew"] = machine.said()
    machine.dead = True
    run(5, lambda counter: block(counter, -3_000, 1))
    saw["dead"] = machine.said()
    machine.dead = False
    run(12, lambda counter: block(counter, -99_999, 1))
    saw["limited"] = machine.said()
    # The largest step, and the most that an axis goes within a second.
    by_axis = {}
    for at, axis, step in machine.writes:
        by_axis.setdefault(axis, []).append((at, abs(step)))
    within = [
        sum(step for when, step in writes[n:] if when <= writes[n][0] + 1_000)
        for writes in by_axis.values() for n in range(len(writes))
    ]
    saw["largest_step_um"] = max(abs(step) for _, _, step in machine.writes)
    saw["most_in_a_second_um"] = max(within)
    print(json.dumps(saw))


if __name__ == "__main__":
    main()
