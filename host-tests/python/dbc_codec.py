"""cantools, and the C code that it writes from the DBC, on frames of every message, compared with our
codec both ways.

Lines: identifier, data as drawn, then the signal for which our codec refuses the frame, or "ok", the
data that our codec writes of what it has read, and what that was, name=value in the DBC's units, "na"
where it is not available.

- cantools reads the same values from the drawn frame and from the written one, each within the
  range of its signal; a frame that we refuse has a value there that the DBC gives no meaning.
- cantools writes these values to the same bytes.
- The C code reads the same raw values from the written frame, and packs them to the same bytes.
"""

import subprocess
import sys
from pathlib import Path

import cantools
from cantools.database.can.c_source import camel_to_snake_case

PROGRESS = 20_000


def not_available(message, name):
    """The raw number that stands for it; None where a signal is always there."""
    choices = message.get_signal_by_name(name).choices or {}
    return next((raw for raw, text in choices.items() if str(text) == "NotAvailable"), None)


def has_meaning(signal, value):
    """Whether the DBC gives the value, in its units, a meaning."""
    if signal.choices and not signal.is_float:
        named = [raw for raw, text in signal.choices.items() if str(text) != "NotAvailable"]
        if named:
            return value in named
    return signal.minimum - 1e-9 <= value <= signal.maximum + 1e-9


class Codec:
    def __init__(self, dbc):
        self.database = cantools.database.load_file(dbc, strict=True)
        self.lines, self.wrong, self.for_c = 0, [], []
        self.taken = 0

    def decode(self, message, data, scaling=True):
        return message.decode(data, decode_choices=False, scaling=scaling, allow_truncated=False)

    def check(self, line):
        frame_id, drawn, verdict, *rest = line.split()
        message = self.database.get_message_by_frame_id(int(frame_id, 16))
        drawn = bytes.fromhex(drawn)
        try:
            read = self.decode(message, drawn)
        except cantools.database.DecodeError:
            # An item that there is not; our codec looks at the reason before it.
            return message.is_multiplexed() and verdict in ("Item", "LastRefused")
        if verdict != "ok":
            return not has_meaning(message.get_signal_by_name(verdict), read[verdict])
        self.taken += 1
        written, values = bytes.fromhex(rest[0]), dict(it.split("=") for it in rest[1:])
        again = self.decode(message, written)
        raw = self.decode(message, written, scaling=False)
        protected = {"Crc", "Counter"} if "Crc" in again else set()
        if set(again) != set(values) | protected:
            return False
        # Both halves of a pair are missing if one is.
        missing = [name for name, value in values.items() if value == "na"]
        if message.name == "OffsetXY" and missing:
            drawn_raw = self.decode(message, drawn, scaling=False)
            if not any(drawn_raw[name] == not_available(message, name) for name in missing):
                return False
        for name, value in values.items():
            if value == "na":
                if raw[name] != not_available(message, name):
                    return False
                continue
            value = float(value)
            signal = message.get_signal_by_name(name)
            if not has_meaning(signal, value):
                return False
            if abs(again[name] - value) > 1e-9 or abs(read[name] - value) > 1e-9:
                return False
        if message.encode(again, strict=not missing) != written:
            return False
        self.for_c.append((message, written, raw))
        return True

    def run(self, lines):
        for line in lines:
            self.lines += 1
            if not self.check(line):
                self.wrong.append(line.strip())
            if self.lines % PROGRESS == 0:
                print(f"cantools: {self.lines} frames", file=sys.stderr)


def c_program(messages):
    """Reads identifiers and data; writes raw values in the order of the struct, and packs again."""
    cases = []
    for message in messages:
        name = "trueup_" + camel_to_snake_case(message.name)
        fields = [camel_to_snake_case(signal.name) for signal in message.signals]
        values = "".join(f'            printf("%lld ", (long long)it.{field});\n' for field in fields)
        cases.append(
            f"        case {message.frame_id}: {{\n"
            f"            struct {name}_t it;\n"
            "            memset(&it, 0, sizeof it);\n"
            f"            if ({name}_unpack(&it, data, length) != 0) return 1;\n"
            f"{values}"
            f"            packed = {name}_pack(out, &it, length);\n"
            "            break;\n"
            "        }\n"
        )
    return (
        "#include <stdio.h>\n#include <string.h>\n#include \"trueup.h\"\n\n"
        "int main(void)\n{\n"
        "    unsigned id, length, byte, n;\n"
        "    uint8_t data[8], out[8];\n"
        "    while (scanf(\"%u %u\", &id, &length) == 2) {\n"
        "        int packed = -1;\n"
        "        for (n = 0; n < length; n++) {\n"
        "            if (scanf(\"%x\", &byte) != 1) return 1;\n"
        "            data[n] = (uint8_t)byte;\n"
        "        }\n"
        "        memset(out, 0, sizeof out);\n"
        "        switch (id) {\n" + "".join(cases) + "        default: return 1;\n        }\n"
        "        if (packed != (int)length) return 1;\n"
        "        for (n = 0; n < length; n++) printf(\"%02x\", out[n]);\n"
        "        printf(\"\\n\");\n"
        "    }\n    return 0;\n}\n"
    )


def check_c(codec, dbc, folder):
    """How many frames the C code reads or packs otherwise."""
    generate = [sys.executable, "-m", "cantools", "generate_c_source", "--database-name", "trueup"]
    subprocess.run([*generate, dbc], cwd=folder, check=True, stdout=sys.stderr)
    (folder / "main.c").write_text(c_program(codec.database.messages), encoding="ascii")
    compile_it = ["cc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-o", "codec"]
    subprocess.run([*compile_it, "main.c", "trueup.c"], cwd=folder, check=True)
    asked = "".join(
        f"{message.frame_id} {len(data)} {data.hex(' ')}\n" for message, data, _ in codec.for_c
    )
    ended = subprocess.run(
        [folder / "codec"], input=asked, capture_output=True, text=True, check=True
    )
    answers = ended.stdout.splitlines()
    differ = abs(len(answers) - len(codec.for_c))
    for (message, data, raw), answer in zip(codec.for_c, answers):
        *values, packed = answer.split()
        found = dict(zip([signal.name for signal in message.signals], map(int, values)))
        # What belongs to other items is left at 0.
        expected = {name: raw.get(name, 0) for name in found}
        if found != expected or bytes.fromhex(packed) != data:
            differ += 1
            if differ <= 10:
                print(f"C: {message.name} {data.hex()}: {answer}", file=sys.stderr)
    print(f"C code: {len(answers)} frames read and packed", file=sys.stderr)
    return differ


def main():
    dbc, frames, folder = (Path(argument).resolve() for argument in sys.argv[1:])
    codec = Codec(dbc)
    with open(frames, encoding="ascii") as lines:
        codec.run(lines)
    for line in codec.wrong[:10]:
        print(f"cantools: {line}", file=sys.stderr)
    differ = len(codec.wrong) + check_c(codec, dbc, folder)
    print(f"{codec.lines} frames, {codec.taken} of them taken, {differ} differ")


if __name__ == "__main__":
    main()
