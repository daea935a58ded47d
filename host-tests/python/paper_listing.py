"""The arithmetic of the printed listing of the paper on axes and temperature (its network 2), in awlsim: once as its formula
T = (counts - 4000) / 16 asks, once with its words and constants. Prints the counts, what each hands over as tenths of a
degree, and whether awlsim takes the constant of the printed zero, as one line of JSON.
"""

import json
import struct

from awlsim.core.cpu import S7CPU
from awlsim.awlcompiler.tokenizer import AwlParser

COUNTS = [4000, 4376, 4368, 4672, 4007]

# Whole degrees and remainder by 16 counts a degree; tenths of the remainder; whole * 10 + tenths.
RIGHT = """
L MW 500; T MW 200; L MW 200; L 4000; -I; T MW 190; L 16; /I; T MW 196;
L 16; *I; T MW 192; L MW 190; L MW 192; -I; L 10; *I; L 16; /I; T MW 160;
L MW 196; L 10; *I; L MW 160; +I; T MW 220;
"""
# As printed, MW250 and MW252 as network 1 loads them, the sum as it is: never stored.
PRINTED = """
L B#16#10; T MW 250; L {zero}; T MW 252;
L MW 500; T MW 200; L {reading}; L {zero_word}; -I; T MW 198; L MW 250; /I; T MW 196;
L B#16#10; *I; L MW 250; /I; L MW 196; T MW 160;
L 0; T MW 198; L B#16#10; *I; L MW 160; L MW 200; +I;
L MW 200; T MW 220;
"""


def handed_over(statements, counts):
    """What stands in MW220 after one cycle with these counts."""
    cpu = S7CPU()
    cpu.getSpecs().setNrInputs(512)
    parser = AwlParser()
    parser.parseText("ORGANIZATION_BLOCK OB 1\nBEGIN\n" + statements.replace("; ", ";\n") + "\nEND_ORGANIZATION_BLOCK\n")
    cpu.load(parser.getParseTree())
    cpu.build()
    cpu.startup()
    flags = cpu.flags.getDataBytes()
    struct.pack_into(">h", flags, 500, counts)
    cpu.runCycle()
    return struct.unpack_from(">h", flags, 220)[0]


def is_taken(constant):
    try:
        handed_over(f"L {constant};", 0)
    except Exception:  # of awlsim: whichever it raises for a constant that is none
        return False
    return True


def main():
    words = {"zero": "W#16#4000", "reading": "IW 200", "zero_word": "IW 252"}
    meant = {"zero": "4000", "reading": "MW 200", "zero_word": "MW 252"}
    print(json.dumps({
        "counts": COUNTS,
        "right": [handed_over(RIGHT, counts) for counts in COUNTS],
        "printed": [handed_over(PRINTED.format(**words), counts) for counts in COUNTS],
        "meant": [handed_over(PRINTED.format(**meant), counts) for counts in COUNTS],
        "takes_printed_zero": is_taken("B#16#4000"),
    }))


if __name__ == "__main__":
    main()
