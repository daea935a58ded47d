"""A CANopen master made of other people's code: PyPI canopen over python-can's SLCAN, with the
bridge's own EDS file. It plays one session with a bridge and prints what it saw as JSON.

The session: hear the heartbeat; read every object of the EDS; commit each misuse and note its abort
code; read the running calibration, load another and read it back, while the offsets go on; engage,
and be refused; fall silent, and be told so by an emergency; restart the board with what was loaded.
"""

import argparse
import faulthandler
import json
import struct
import sys
import threading
import time

import canopen
import e2e.p05
from canopen.objectdictionary import ODVariable
from canopen.sdo import SdoAbortedError

OFFSET_XY, CONTROL, HEARTBEAT = 0x181, 0x302, 0x701
PATIENCE_S = 60.0
NUMBERS = {0x04: "<i", 0x05: "<B", 0x06: "<H", 0x07: "<I"}
TEXT = 0x09
RUNNING, NEW = (0x2100, 1), (0x2100, 2)
# Bits of Control: engaged and referenced; referenced, with the operator's leave to write.
ENGAGED, SERVICE = 3, 10
STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x02, 0x80, 0x81, 0x82


class Session:
    def __init__(self, network, node, new):
        self.network, self.node, self.sdo, self.new = network, node, node.sdo, new
        self.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        self.states, self.cycles, self.gaps, self.last = [], 0, 0, None
        self.control_counter, self.says = 0, None
        network.subscribe(HEARTBEAT, lambda _id, data, _time: self.states.append(data[0]))
        network.subscribe(OFFSET_XY, self.hear_offset)

    def hear_offset(self, _id, data, _time):
        if self.last is not None and data[2] != (self.last + 1) % 256:
            self.gaps += 1
        self.last = data[2]
        self.cycles += 1

    def wait(self, what, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: never within {PATIENCE_S} s")
            time.sleep(0.02)

    def emergencies_from(self, code):
        """The codes that have come, from the first of this code on."""
        codes = [error.code for error in self.node.emcy.log]
        return codes[codes.index(code) :] if code in codes else []

    def number(self, index, subindex):
        return int.from_bytes(self.sdo.upload(index, subindex), "little")

    def read_everything(self):
        """Each value by its name, read with its type, or the abort code; and what is wrong."""
        values, wrong = {}, []
        for entry in self.node.object_dictionary.values():
            variables = [entry] if isinstance(entry, ODVariable) else entry.values()
            for it in variables:
                name = f"{it.index:04X}:{it.subindex}"
                try:
                    data = self.sdo.upload(it.index, it.subindex)
                except SdoAbortedError as abort:
                    values[name] = f"abort {abort.code:08X}"
                    continue
                if it.data_type in NUMBERS:
                    if len(data) != struct.calcsize(NUMBERS[it.data_type]):
                        wrong.append(f"{name} has {len(data)} bytes")
                        continue
                    values[name] = struct.unpack(NUMBERS[it.data_type], data)[0]
                elif it.data_type == TEXT:
                    values[name] = data.decode("ascii")
                else:
                    values[name] = f"{len(data)} bytes"
                if it.access_type == "const" and values[name] != it.default:
                    wrong.append(f"{name} is {values[name]}, in the EDS {it.default}")
        return values, wrong

    def load(self, data, size=None, in_blocks=False):
        stream = self.sdo.open(*NEW, "wb", size=size or len(data), block_transfer=in_blocks)
        with stream:
            stream.write(data)

    def raw(self, *frames):
        """Frames straight to the server; the abort of the last answer is raised."""
        for frame in frames:
            answer = self.sdo.request_response(bytes(frame).ljust(8, b"\0"))
        return answer

    def late(self):
        """The first segment never comes."""
        self.raw(struct.pack("<BHBI", 0x21, *NEW, 14))
        self.sdo.read_response()

    def misuses(self):
        start = struct.pack("<BHB", 0x40, 0x1008, 0)
        damaged = bytearray(self.new)
        damaged[60] ^= 1
        return [
            ("toggle bit", 0x05030000, lambda: self.raw(start, [0x70])),
            ("toggle bit, download", 0x05030000, lambda: self.raw(
                struct.pack("<BHBI", 0x21, *NEW, 14), [0x10, 1, 2, 3, 4, 5, 6, 7])),
            ("silence", 0x05040000, self.late),
            ("no such command", 0x05040001, lambda: self.raw([0xE0])),
            ("segment of nothing", 0x05040001, lambda: self.raw([0x60])),
            ("block upload", 0x05040001, lambda: self.raw(
                struct.pack("<BHBI", 0xA4, *RUNNING, 0x7F))),
            ("block download of a number", 0x05040001, lambda: self.raw(
                struct.pack("<BHBI", 0xC6, 0x1017, 0, 2))),
            ("block download of other bytes than its CRC says", 0x05040004, lambda: self.raw(
                struct.pack("<BHBI", 0xC6, *NEW, 7), [0x81], [0xC1, 1])),
            ("read what is written", 0x06010001, lambda: self.sdo.upload(0x2010, 6)),
            ("write a constant", 0x06010002, lambda: self.sdo.download(0x1000, 0, bytes(4))),
            ("write an offset", 0x06010002, lambda: self.sdo.download(0x2000, 1, bytes(4))),
            ("write the running blob", 0x06010002, lambda: self.sdo.download(*RUNNING, self.new)),
            ("no object", 0x06020000, lambda: self.sdo.upload(0x1FFF, 0)),
            ("no object, write", 0x06020000, lambda: self.sdo.download(0x5000, 0, b"\0")),
            ("length", 0x06070010, lambda: self.sdo.download(0x1017, 0, bytes(4))),
            ("announced length", 0x06070010, lambda: self.raw(
                struct.pack("<BHBI", 0x21, *NEW, 3), [0x01, 1, 2, 3, 4, 5, 6, 7])),
            ("too long", 0x06070012, lambda: self.load(bytes(16_385))),
            ("too short", 0x06070013, lambda: self.raw(
                struct.pack("<BHBI", 0x23, *NEW, 1))),
            ("no sub-index", 0x06090011, lambda: self.sdo.upload(0x1018, 9)),
            ("value range", 0x06090030, lambda: self.sdo.download(0x1003, 0, b"\1")),
            ("node above 127", 0x06090030, lambda: self.sdo.download(
                0x1016, 1, struct.pack("<I", 0x00800064))),
            ("damaged calibration", 0x06090030, lambda: self.load(bytes(damaged))),
            ("no calibration", 0x06090030, lambda: self.load(bytes(700))),
            ("nothing loaded yet", 0x08000024, lambda: self.sdo.upload(*NEW)),
        ]

    def abort_of(self, action):
        try:
            action()
        except SdoAbortedError as abort:
            # canopen ends a stream that was refused once more, which is refused as well: the first
            # abort is the one that counts.
            while isinstance(abort.__context__, SdoAbortedError):
                abort = abort.__context__
            return abort.code
        return None

    def commit(self, misuses):
        seen = []
        for name, expected, action in misuses:
            began = time.monotonic()
            code = self.abort_of(action)
            took_s = round(time.monotonic() - began, 1)
            said = "nothing" if code is None else f"{code:08X}"
            seen.append({"misuse": name, "expected": f"{expected:08X}", "abort": said, "took_s": took_s})
        return seen

    def keep_control(self):
        """What a CNC says all the time, as long as there is one."""
        while True:
            if self.says is not None:
                self.send_control(self.says)
            time.sleep(0.02)

    def send_control(self, bits):
        data = bytearray(8)
        data[2] = self.control_counter
        data[3] = bits
        e2e.p05.e2e_p05_protect(data, CONTROL, increment_counter=True)
        self.control_counter = data[2]
        self.network.send_message(CONTROL, bytes(data))

    def engaged(self):
        """What is refused while an offset is followed."""
        self.says = ENGAGED
        try:
            self.wait("live", lambda: self.number(0x2001, 1) == 1)
            self.wait("settled", lambda: not self.number(0x2001, 2) & 2)
            # Nobody can restart it now, nor stop it.
            clock = self.number(0x2001, 5)
            for command in (RESET_NODE, STOP, PRE_OPERATIONAL):
                self.node.nmt.send_command(command)
            cycles = self.cycles
            self.wait("offsets go on", lambda: self.cycles > cycles + 500)
            values = {
                "quality_after_nmt": self.number(0x2001, 1),
                "clock_goes_on": self.number(0x2001, 5) > clock,
                "elongation_nm": struct.unpack("<i", self.sdo.upload(0x9130, 9))[0],
                "offset_z_nm": struct.unpack("<i", self.sdo.upload(0x2000, 3))[0],
                "accepted": self.number(0x2030, 1),
            }
            misuses = self.commit([
                ("load while engaged", 0x08000022, lambda: self.load(self.new)),
                ("forget while engaged", 0x08000022, lambda: self.sdo.download(
                    0x2010, 6, b"zero")),
            ])
        finally:
            self.says = None
        self.wait("CNC lost", lambda: self.emergencies_from(0x8100))
        self.wait("off", lambda: self.number(0x2001, 1) == 0)
        self.says = SERVICE
        self.wait("CNC back", lambda: 0 in self.emergencies_from(0x8100))
        return values, misuses

    def consumer(self):
        """A heartbeat that the bridge is to hear, and then does not."""
        self.sdo.download(0x1016, 1, struct.pack("<I", 2 << 16 | 300))
        for _ in range(5):
            self.network.send_message(0x702, [5])
            time.sleep(0.05)
        self.wait("lost", lambda: self.emergencies_from(0x8130))
        self.sdo.download(0x1016, 1, bytes(4))
        self.wait("switched off", lambda: 0 in self.emergencies_from(0x8130))

    def producer(self):
        """Heartbeats in a second of the board, whose offsets count it, at 20 ms each."""
        self.sdo.download(0x1017, 0, struct.pack("<H", 20))
        before, began = len(self.states), self.cycles
        self.wait("a second", lambda: self.cycles >= began + 1_000)
        rate = (len(self.states) - before) * 1_000 / (self.cycles - began)
        self.sdo.download(0x1017, 0, struct.pack("<H", 100))
        return rate

    def reset_communication(self):
        """Settings are as at the start, the node has booted up once more, the offsets go on."""
        self.sdo.download(0x1015, 0, struct.pack("<H", 7))
        self.sdo.download(0x1017, 0, struct.pack("<H", 500))
        boots = self.states.count(0)
        self.node.nmt.send_command(RESET_COMMUNICATION)
        self.wait("boot-up", lambda: self.states.count(0) == boots + 1)
        return [self.number(0x1015, 0), self.number(0x1017, 0)]

    def restart(self):
        """The node restarts with what was loaded; its adapter is closed and opened again."""
        clock = self.number(0x2001, 5)
        # After this the counter starts again as well.
        gaps = self.gaps
        self.node.nmt.send_command(RESET_NODE)
        time.sleep(0.05)
        self.says = None
        time.sleep(0.5)
        # The boot-up message comes while the adapter is still closed, so a heartbeat has to do.
        end, beats = time.monotonic() + PATIENCE_S, len(self.states)
        while len(self.states) == beats:
            if time.monotonic() > end:
                raise TimeoutError("it does not restart")
            self.network.bus.open()
            time.sleep(0.2)
        self.gaps = gaps
        return {
            "clock_before": clock,
            "clock": self.number(0x2001, 5),
            "running_crc": self.number(0x2100, 3),
            "new_crc": self.number(0x2100, 4),
            "runs_on_the_new_one": self.sdo.upload(*RUNNING) == self.new,
        }

    def play(self):
        self.wait("a heartbeat", lambda: 4 in self.states)
        saw = {}
        without = [("nobody allows it", 0x08000022, lambda: self.sdo.download(
            0x1017, 0, struct.pack("<H", 0)))]
        saw["misuses"] = self.commit(without)
        threading.Thread(target=self.keep_control, daemon=True).start()
        self.says = SERVICE
        self.wait("the operator allows it", lambda: self.number(0x2001, 8) == 2)
        saw["values"], saw["wrong"] = self.read_everything()
        saw["misuses"] += self.commit(self.misuses())
        running = self.sdo.upload(*RUNNING)
        saw["running"] = running.hex()
        self.load(running, in_blocks=True)
        saw["running_in_blocks"] = self.sdo.upload(*NEW).hex()
        cycles, began = self.cycles, time.monotonic()
        self.load(self.new)
        saw["load_s"] = time.monotonic() - began
        saw["load_cycles"] = self.cycles - cycles
        saw["read_back_is_equal"] = self.sdo.upload(*NEW) == self.new
        saw["new_crc"] = self.number(0x2100, 4)
        saw["running_again_is_equal"] = self.sdo.upload(*RUNNING) == running
        saw["engaged"], more = self.engaged()
        saw["misuses"] += more
        self.consumer()
        saw["heartbeats_per_s"] = self.producer()
        saw["history"] = [self.number(0x1003, 1 + n) for n in range(self.number(0x1003, 0))]
        saw["emergencies"] = [[error.code, error.register] for error in self.node.emcy.log]
        saw["states"], saw["first_state"] = sorted(set(self.states)), self.states[0]
        saw["after_reset_communication"] = self.reset_communication()
        saw["restart"] = self.restart()
        saw["cycles"], saw["gaps"] = self.cycles, self.gaps
        return saw


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("channel", help="what python-can opens, for example socket://HOST:PORT")
    parser.add_argument("eds")
    parser.add_argument("calibration", help="the blob to load")
    parser.add_argument("--patience", type=float, default=PATIENCE_S, metavar="S",
                        help="how long to wait for each answer: more where the board is slower than life")
    options = parser.parse_args()
    globals()["PATIENCE_S"] = options.patience
    # Whatever hangs, this ends.
    faulthandler.dump_traceback_later(10 * PATIENCE_S, exit=True)
    with open(options.calibration, "rb") as file:
        new = file.read()
    network = canopen.Network()
    node = network.add_node(1, options.eds)
    session = Session(network, node, new)
    network.connect(
        interface="slcan", channel=options.channel, bitrate=1_000_000, sleep_after_open=0.0
    )
    try:
        json.dump(session.play(), sys.stdout, indent=1)
    finally:
        network.disconnect()


if __name__ == "__main__":
    main()
