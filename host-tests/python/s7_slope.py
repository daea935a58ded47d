"""K0 and slope by way of the PLC program of integrations/siemens-840d in awlsim, its clock by hand. Prints what the NCK
got as one line of JSON: after a block with slopes, on the way there, after a block that is not whole, after the way back,
and by a program that hands over no slopes.
"""

import json
import struct

from s7_cuts import block, crc
from s7_plc import HOLDING_AT, Cpu

CYCLE_MS = 100
AT_NCK = [170, 174, 178, 182, 186, 190]


def with_slopes(counter, k0_um, slope_um_per_m, quality=1):
    """The first 64 bytes of DB 900 in mode slope: K0 and slopes as offsets, three axes each."""
    head = struct.pack(">HH3iHHHHH", 2, counter & 0xFFFF, *(round(100 * it) for it in k0_um), quality, 0, 3, 0, 0)
    body = head + struct.pack(">IIi8h", 0, 0, 0, *[0] * 8)
    body += struct.pack(">H", crc(body, 0x0181))
    body += struct.pack(">3h", *(round(10 * it) for it in slope_um_per_m))
    return body + struct.pack(">H", crc(body, 0x0381))


def run(plc, cycles, shown):
    """What the NCK has after each cycle."""
    values = []
    for _ in range(cycles):
        run.counter += 1
        data = shown(run.counter)
        plc.block[: len(data)] = data
        plc.word(102, CYCLE_MS)
        plc.cpu.runCycle()
        plc.set_bit("restart", False)
        values.append([plc.real(at) for at in AT_NCK])
    return values


run.counter = 0


def main():
    plc = Cpu(slopes=True)
    plc.set_bit("enable", True)
    k0, slope = (-6.0, 1.5, 0.0), (-13.5, 0.0, 2.7)
    there = run(plc, 450, lambda counter: with_slopes(counter, k0, slope))
    states = [plc.number("STATE")]
    # A slope of another block, as a write in two parts would leave it.
    torn = with_slopes(7, k0, (999.0, 0.0, 0.0))
    held = run(plc, 30, lambda counter: with_slopes(counter, k0, slope)[:56] + torn[56:])
    states.append(plc.number("STATE"))
    steep = run(plc, 30, lambda counter: with_slopes(counter, k0, (1_000.1, 0.0, 0.0)))
    back = run(plc, 450, lambda counter: with_slopes(counter, (0.0,) * 3, (0.0,) * 3, 5))
    # A gateway without slopes: what stands in their place is not looked at.
    flat = run(plc, 60, lambda counter: block(counter, -600, 1) + torn[56:])
    other = Cpu(slopes=False)
    other.set_bit("enable", True)
    refused = run(other, 30, lambda counter: with_slopes(counter, k0, slope))
    print(json.dumps({
        "there": there[-1], "way": there[::5], "states": states, "held": [held[0], held[-1]], "steep": steep[-1],
        "back": back[::5], "end": back[-1], "flat": flat[-1], "refused": refused[-1],
        "rejected": other.number("REJECTED"), "cycle_ms": CYCLE_MS,
    }))


if __name__ == "__main__":
    main()
