"""A CPU's data block 900 made of other people's code: python-snap7's server."""

import socket

from snap7.server import Server
from snap7.type import SrvArea

INPUT_BYTES, HOLDING_AT, BLOCK_BYTES = 56, 64, 104


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def serve(port, block):
    server = Server(log=False)
    server.register_area(SrvArea.DB, 900, block)
    server.start_to("127.0.0.1", port)
    return server
