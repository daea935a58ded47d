"""Verdicts of AUTOSAR E2E profile 5 on frames, one by one, compared with ours.

The CRC is autosar-e2e's; it has no counter check, so that is written here, after the specification
of E2E_P05Check: the difference to the counter of the last frame with a good CRC is 0: repeated; 1: in
order; up to MaxDeltaCounter: some lost; more: wrong sequence. The first good frame sets the counter.

Lines: identifier, data, our verdict.
"""

import sys

import e2e.p05

MAX_DELTA_COUNTER = 15


class Check:
    def __init__(self, data_id):
        self.data_id, self.counter = data_id, None

    def verdict(self, data):
        if not e2e.p05.e2e_p05_check(data, self.data_id):
            return "crc"
        last, self.counter = self.counter, data[2]
        if last is None:
            return "ok"
        delta = (data[2] - last) % 256
        if delta == 0:
            return "repeated"
        if delta == 1:
            return "ok"
        return "some-lost" if delta <= MAX_DELTA_COUNTER else "wrong-sequence"


def main():
    checks, count, differ = {}, 0, 0
    with open(sys.argv[1], encoding="ascii") as lines:
        for line in lines:
            frame_id, data, ours = line.split()
            frame_id = int(frame_id, 16)
            theirs = checks.setdefault(frame_id, Check(frame_id)).verdict(bytes.fromhex(data))
            count += 1
            if theirs != ours:
                differ += 1
                if differ <= 10:
                    print(f"line {count}: {theirs}, ours {ours}: {line.strip()}", file=sys.stderr)
    print(f"{count} frames, {differ} differ")


if __name__ == "__main__":
    main()
