"""Protects payloads with the PyPI package autosar-e2e, to compare it with this project's own code.

Reads lines `data-id payload` (hexadecimal; the counter is byte 2 of the payload), and writes for
each the protected payload, and `1` if the package's own check accepts it.
"""

import sys

import e2e.p05

for line in sys.stdin:
    data_id, payload = line.split()
    data = bytearray.fromhex(payload)
    e2e.p05.e2e_p05_protect(data, int(data_id, 16), increment_counter=False)
    print(data.hex(), int(e2e.p05.e2e_p05_check(bytes(data), int(data_id, 16))))
