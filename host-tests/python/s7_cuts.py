"""The PLC program of integrations/siemens-840d in awlsim, its clock by hand: so many cuts of either line at random
moments, of random length, with blocks that are damaged, swapped, replayed and half old between them, a PLC that is
stopped and started, and an NCK that is slow, refuses or does not answer. No step that the NCK gets may be above
the slew limit. Prints what it saw as one line of JSON.

A bridge is simulated as its documentation says: engaged after three blocks without Engage, it follows a drifting
target, holds without Control for the link timeout and the hold time, then ramps out; after a restart it has no
offset until it is engaged anew.
"""

import argparse
import json
import random
import struct

from s7_plc import HOLDING_AT, INPUT_BYTES, Cpu

SLEW_UM_PER_S = 20.0
CYCLE_MS = 40
SETTLE_MS = 30_000
LONGEST_MS = 100  # what the program takes one step for at most
NOT_AVAILABLE = -(2**31)


def crc(data, data_id):
    value = 0xFFFF
    for byte in data + struct.pack("<H", data_id):
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def block(counter, offset, quality):
    """The input block; offset in 0.01 um or None."""
    z = NOT_AVAILABLE if offset is None else round(offset)
    xyz = (NOT_AVAILABLE,) * 3 if offset is None else (0, -z // 4, z)
    head = struct.pack(">HH3iHHHHH", 1, counter & 0xFFFF, *xyz, quality, 0, 3, 0, 0)
    body = head + struct.pack(">IIi8h", 0, 0, 0, *[0] * 8)
    return body + struct.pack(">H", crc(body, 0x0181))


LINES = ["plc line", "bridge line"]
KINDS = ["plc line", "plc line", "bridge line", "bridge line", "bridge line", "damage", "swap", "replay", "half",
         "stop", "slow", "refuse", "never", "disable", "bridge restart"]


class Bridge:
    """What the bridge says, millisecond by millisecond."""

    def __init__(self):
        self.restart(0)

    target, wanders = 6_000.0, True

    def restart(self, now):
        self.offset, self.quality, self.released = None, 6, 0
        self.heard, self.counter = now, None

    def hear(self, now, said):
        counter, control = struct.unpack_from(">HH", said)
        if crc(said[:-2], 0x0302) != struct.unpack(">H", said[-2:])[0] or counter == self.counter:
            return
        self.counter, self.heard = counter, now
        engage = control & 1
        if not engage:
            self.released += 1
        if self.quality == 6 and engage and self.released >= 3:
            self.offset, self.quality = 0.0, 1
        elif self.quality != 6:
            self.quality = 1 if engage else (0 if self.offset == 0 else 5)
        if engage:
            self.released = 0

    def live(self, now, ms):
        step = SLEW_UM_PER_S * 100 * ms / 1000
        if self.wanders:
            self.target += random.uniform(-1, 1) * 3
        if self.quality == 6:
            return
        silent = now - self.heard
        if silent > 2_500:
            goal, self.quality = 0.0, 5 if self.offset else 0
        elif silent > 500:
            goal, self.quality = self.offset, 4
        else:
            goal = self.target if self.quality == 1 else 0.0
        self.offset += max(-step, min(step, goal - self.offset))


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cuts", type=int, default=20)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--lines", action="store_true", help="nothing but cuts of the two lines")
    arguments = arguments.parse_args()
    drawn = LINES if arguments.lines else KINDS
    random.seed(arguments.seed)
    plc, bridge = Cpu(), Bridge()
    plc.set_bit("enable", True)
    now = counter = 0
    shown = block(0, None, 6)
    old = shown
    told = {"held": 0, "ramped": 0, "no offset": 0, "followed": 0}
    kinds, deck = {}, []
    largest = worst = 0.0
    nck, written_at = [0.0] * 3, 0
    cuts, until, kind, plc_stopped = 0, 1_000, "none", False
    states = set()
    end = None
    while end is None or now < end:
        if cuts == arguments.cuts and end is None:
            # Nothing wrong any more: everything is to come back by itself.
            kind, until, end, bridge.wanders = "none", now + SETTLE_MS, now + SETTLE_MS, False
            plc.word(160, 2)
            plc.flags[162] = 0
            plc.set_bit("enable", True)
        if now >= until:
            cuts += kind == "none"
            if kind == "none":
                if not deck:
                    deck = random.sample(drawn, len(drawn))
                kind = deck.pop()
            else:
                kind = "none"
            longest = 600 if kind == "none" else random.choice([60, 400, 800, 3_500])
            until = now + random.randrange(20, longest + 20)
            kinds[kind] = kinds.get(kind, 0) + 1
            plc.word(160, random.choice([1, 4, 30]) if kind == "slow" else 2)
            plc.flags[162] = {"refuse": 1, "never": 2}.get(kind, 0)
            plc.set_bit("enable", kind != "disable")
            if kind == "bridge restart":
                bridge.restart(now)
        if kind == "none" and plc_stopped:
            plc.set_bit("restart", True)
            for n in range(3):
                plc.real(104 + 4 * n, plc.real(170 + 4 * n))
        plc_stopped = kind == "stop"
        # The gateway: what it receives goes into the block, as long as both its lines hold.
        bridge.live(now, CYCLE_MS)
        is_receiving = kind != "bridge line"
        if kind != "plc line":
            counter += 1
            shown = block(counter, bridge.offset if is_receiving else None, bridge.quality if is_receiving else 6)
            if random.random() < 0.02:
                old = shown
        seen = bytearray(shown)
        if kind == "damage":
            for _ in range(random.randrange(1, 4)):
                bit = random.randrange(8 * INPUT_BYTES)
                seen[bit // 8] ^= 1 << bit % 8
        elif kind == "swap":
            seen[4:8], seen[12:16] = seen[12:16], seen[4:8]
        elif kind == "replay" and random.random() < 0.5:
            seen = bytearray(old)
        elif kind == "half":
            at = 2 * random.randrange(1, INPUT_BYTES // 2)
            seen[:at] = block(counter + 1, (bridge.offset or 0) + 500, 1)[:at]
        if not plc_stopped:
            plc.block[:INPUT_BYTES] = seen
            plc.word(102, CYCLE_MS)
            plc.cpu.runCycle()
            plc.set_bit("restart", False)
            state = plc.number("STATE")
            states.add(state)
            told["held"] += state == 4
            told["ramped"] += state == 5
            told["no offset"] += state == 6
            told["followed"] += state == 1
            if kind not in ("plc line",) and is_receiving:
                bridge.hear(now, bytes(plc.block[HOLDING_AT : HOLDING_AT + 34]))
        is_now = [plc.real(at) for at in (170, 174, 178)]
        if is_now != nck:
            step = max(abs(a - b) for a, b in zip(is_now, nck)) * 1000
            may = SLEW_UM_PER_S * min(LONGEST_MS, now - written_at) / 1000
            largest, worst = max(largest, step), max(worst, step - may)
            nck, written_at = is_now, now
        now += CYCLE_MS
    print(json.dumps({
        "cuts": cuts, "seconds": now / 1000, "kinds": kinds, "cycles": told, "states": sorted(states),
        "largest_step_um": largest, "above_slew_um": worst, "rejected": plc.number("REJECTED"),
        "writes": plc.word(164), "nck_um": [it * 1000 for it in nck], "offset_um": (bridge.offset or 0) / 100,
    }))


if __name__ == "__main__":
    main()
