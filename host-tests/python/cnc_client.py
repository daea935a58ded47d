"""A CNC made of other people's code: python-can speaks SLCAN, cantools reads the DBC, autosar-e2e
protects and checks. It plays one session with a bridge and prints what it saw as JSON.

The session: listen; send damaged `Control` frames, then repeated ones, as two masters would; say for
4 s that nothing is engaged, as after every start of a bridge; engage and wait until the offset has
settled; listen for 1,000 cycles; disengage and listen until the offset is gone.
"""

import argparse
import faulthandler
import json
import sys
import time

import can
import cantools
import e2e.p05

OFFSET_XY, OFFSET_Z, STATUS = 0x181, 0x281, 0x381
HEARTBEAT, EMERGENCY = 0x701, 0x081
SPINDLE, CONTROL = 0x202, 0x302
PERIOD_S = 0.020
OFF, LIVE, RAMPING_OUT, FAULT = 0, 1, 5, 6
SLEWING, CNC_LOST = 1 << 1, 1 << 4
SETTLED_CYCLES = 100
MEASURED_CYCLES = 1_000
PATIENCE_S = 60.0


class Sender:
    """One cyclic frame, protected by autosar-e2e, which also counts."""

    def __init__(self, bus, database, frame_id):
        self.bus, self.id = bus, frame_id
        self.message = database.get_message_by_frame_id(frame_id)
        self.counter = 0

    def send(self, repeat=False, damage=False, **signals):
        data = bytearray(self.message.encode({"Crc": 0, "Counter": self.counter, **signals}))
        e2e.p05.e2e_p05_protect(data, self.id, increment_counter=not repeat)
        self.counter = data[2]
        if damage:
            data[0] ^= 0x01
        self.bus.send(can.Message(arbitration_id=self.id, data=data, is_extended_id=False))


class Ear:
    """Receives every frame of the bridge and notes what is wrong with it."""

    def __init__(self, bus, database):
        self.bus, self.database = bus, database
        self.frames = {OFFSET_XY: 0, OFFSET_Z: 0, STATUS: 0, HEARTBEAT: 0, EMERGENCY: 0}
        self.emergencies = []
        self.items, self.reasons, self.board = [], [], {}
        self.wrong = []
        self.states = set()
        self.last_counter = {}
        self.half = None

    def next_cycle(self, on_wait):
        """The next cycle of which both halves have come."""
        while True:
            on_wait()
            frame = self.bus.recv(timeout=0.5)
            if frame is None:
                continue
            cycle = self.hear(frame)
            if cycle is not None:
                return cycle

    def hear(self, frame):
        if frame.arbitration_id not in self.frames or frame.is_extended_id:
            self.wrong.append(f"nobody knows the frame {frame}")
            return None
        self.frames[frame.arbitration_id] += 1
        try:
            said = self.database.decode_message(
                frame.arbitration_id, frame.data, decode_choices=False, allow_truncated=False
            )
        except (ValueError, KeyError, cantools.Error) as error:
            self.wrong.append(f"cantools cannot read {frame}: {error}")
            return None
        if frame.arbitration_id == HEARTBEAT:
            self.states.add(said["State"])
            return None
        if frame.arbitration_id == EMERGENCY:
            self.emergencies.append([said["ErrorCode"], said["Fault"]])
            return None
        if not e2e.p05.e2e_p05_check(bytes(frame.data), frame.arbitration_id):
            self.wrong.append(f"autosar-e2e does not accept {frame}")
            return None
        counter = frame.data[2]
        if said["Counter"] != counter:
            self.wrong.append(f"the counter is {counter} for E2E, {said['Counter']} for the DBC")
        last = self.last_counter.get(frame.arbitration_id)
        if last is not None and counter != (last + 1) % 256:
            self.wrong.append(f"0x{frame.arbitration_id:03x} counts {last}, {counter}")
        self.last_counter[frame.arbitration_id] = counter
        if frame.arbitration_id == STATUS:
            self.items.append(said["Item"])
            if said["LastRefused"] not in self.reasons[-1:]:
                self.reasons.append(said["LastRefused"])
            self.board.update(said)
            return None
        if frame.arbitration_id == OFFSET_XY:
            if self.half is not None:
                self.wrong.append(f"OffsetXY {self.half['Counter']} has no OffsetZ")
            self.half = said
            return None
        half, self.half = self.half, None
        if half is None or half["Counter"] != said["Counter"]:
            self.wrong.append(f"OffsetZ {counter} does not follow the OffsetXY of its cycle")
            return None
        return {**half, **said}


def summary(cycles):
    """What was seen in some cycles: qualities in their order, and the range of each value."""
    qualities = []
    for cycle in cycles:
        if not qualities or qualities[-1] != cycle["Quality"]:
            qualities.append(cycle["Quality"])
    ranges = {
        name: [min(cycle[name] for cycle in cycles), max(cycle[name] for cycle in cycles)]
        for name in ("OffsetX", "OffsetY", "OffsetZ", "Flags", "Age")
    }
    available = [cycle["OffsetZ"] for cycle in cycles if cycle["Quality"] != FAULT]
    z = available or [None]
    ramp = [cycle["OffsetZ"] for cycle in cycles if cycle["Quality"] == RAMPING_OUT]
    return {
        "cycles": len(cycles),
        "qualities": qualities,
        "mean_z_um": sum(available) / len(available) if available else None,
        "last_z_um": z[-1],
        "largest_step_um": max((abs(b - a) for a, b in zip(z, z[1:])), default=0.0),
        "ramp_turns_back": any(b > a for a, b in zip(ramp, ramp[1:])),
        **ranges,
    }


def session(bus, database, board_time):
    ear = Ear(bus, database)
    control, spindle = Sender(bus, database, CONTROL), Sender(bus, database, SPINDLE)
    # The time by which it speaks: this computer's, or the board's, which sends an offset every millisecond.
    clock = (lambda: ear.frames[OFFSET_XY] / 1_000) if board_time else time.monotonic
    end = time.monotonic() + PATIENCE_S * (10 if board_time else 1)
    next_send = clock()
    seen = {}

    def phase(name, send, is_over):
        cycles, sent = [], 0

        def cyclic():
            nonlocal next_send, sent
            now = clock()
            if time.monotonic() > end:
                raise TimeoutError(f"{name} is not over: {cycles[-3:]}, {ear.wrong[:3]}")
            if now >= next_send:
                next_send = max(next_send + PERIOD_S, now)
                send(sent)
                sent += 1

        while not cycles or not is_over(cycles, sent):
            cycles.append(ear.next_cycle(cyclic))
        seen[name] = summary(cycles)

    want = {"Engage": 1, "Referenced": 1, "Zero": 0, "Service": 0, "Confirm": 0}
    want |= {"LearnedPart": 0, "Learned": 0, "LearnedCrc": 0}
    refuse = {**want, "Engage": 0}

    def damaged(_sent):
        control.send(damage=True, **want)

    def repeated(sent):
        # After so many damaged ones three in a row have to be good before one is believed.
        control.send(repeat=sent > 2, **(refuse if sent <= 2 else want))

    def cutting(wanted):
        def send(_sent):
            control.send(**wanted)
            spindle.send(Speed=24_000, Load=0)

        return send

    def settled(cycles, _sent):
        return len(cycles) >= SETTLED_CYCLES and all(
            cycle["Quality"] == LIVE and not cycle["Flags"] & SLEWING
            for cycle in cycles[-SETTLED_CYCLES:]
        )

    def gone(cycles, _sent):
        return len(cycles) >= SETTLED_CYCLES and all(
            cycle["Quality"] == OFF for cycle in cycles[-SETTLED_CYCLES:]
        )

    def silent(_sent):
        pass

    phase("listening", silent, lambda cycles, _sent: len(cycles) >= 200)
    phase("damaged", damaged, lambda cycles, sent: sent > 30 and len(cycles) >= 600)
    # A repeated frame is not a sign of life either.
    phase("repeated", repeated, lambda cycles, sent: sent > 30 and cycles[-1]["Flags"] & CNC_LOST)
    phase("releasing", cutting(refuse), lambda _cycles, sent: sent > 200)
    phase("engaging", cutting(want), settled)
    phase("live", cutting(want), lambda cycles, _sent: len(cycles) >= MEASURED_CYCLES)
    phase("disengaging", cutting(refuse), gone)
    return {
        "offset_xy": ear.frames[OFFSET_XY],
        "offset_z": ear.frames[OFFSET_Z],
        "heartbeats": ear.frames[HEARTBEAT],
        "states": sorted(ear.states),
        "emergencies": ear.emergencies,
        "items": ear.items,
        "reasons": ear.reasons,
        "board": ear.board,
        "wrong": ear.wrong,
        "phases": seen,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("channel", help="what python-can opens, for example socket://HOST:PORT")
    parser.add_argument("dbc")
    parser.add_argument("--board-time", action="store_true", help="the board is slower than life")
    options = parser.parse_args()
    # Whatever hangs, this ends.
    faulthandler.dump_traceback_later(20 * PATIENCE_S if options.board_time else 2 * PATIENCE_S, exit=True)
    database = cantools.database.load_file(options.dbc, strict=True)
    with can.Bus(
        interface="slcan", channel=options.channel, bitrate=1_000_000, sleep_after_open=0.0
    ) as bus:
        json.dump(session(bus, database, options.board_time), sys.stdout, indent=1)


if __name__ == "__main__":
    main()
