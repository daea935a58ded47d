"""Two serial masters of other people, pymodbus and mbpoll, against `trueup gateway modbus --serial`: two pseudo
terminals with a wire between them stand for the line. Prints what they saw as one line of JSON.
"""

import argparse
import json
import os
import pty
import subprocess
import threading
import time
import tty

from pymodbus.client import ModbusSerialClient

BAUD = "19200"
PATIENCE_S = 20


def wire(one, other):
    while data := os.read(one, 512):
        os.write(other, data)


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("trueup")
    arguments.add_argument("mbpoll")
    arguments = arguments.parse_args()
    (ours, gateway_end), (theirs, master_end) = pty.openpty(), pty.openpty()
    for end in (ours, gateway_end, theirs, master_end):
        tty.setraw(end)
    for pair in ((ours, theirs), (theirs, ours)):
        threading.Thread(target=wire, args=pair, daemon=True).start()
    line = ["--baud", BAUD, "--parity", "none", "--serial", os.ttyname(gateway_end)]
    gateway = subprocess.Popen(
        [arguments.trueup, "gateway", "modbus", "--port", "tcp:127.0.0.1:1", *line], stdout=subprocess.DEVNULL
    )
    try:
        device = os.ttyname(master_end)
        client = ModbusSerialClient(device, baudrate=int(BAUD), stopbits=2, timeout=2, retries=0)
        end = time.monotonic() + PATIENCE_S
        block = None
        while block is None and time.monotonic() < end:
            client.connect()
            try:
                block = client.read_input_registers(0, count=28, device_id=1).registers
            except Exception:  # it has only begun
                time.sleep(0.2)
        exception = client.read_coils(0, count=1, device_id=1).exception_code
        client.close()
        poll = [arguments.mbpoll, "-m", "rtu", "-b", BAUD, "-P", "none", "-s", "2", "-t", "3:int", "-B", "-0"]
        said = subprocess.run(
            [*poll, "-r", "2", "-c", "3", "-1", device], capture_output=True, text=True, timeout=PATIENCE_S
        ).stdout
        print(json.dumps({"block": block, "exception": exception, "mbpoll": said}))
    finally:
        gateway.terminate()
        gateway.wait()


main()
