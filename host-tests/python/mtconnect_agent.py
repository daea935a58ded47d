"""What an agent of MTConnect does with an adapter: reads Devices.xml, connects, keeps what the lines of SHDR say.

The vocabulary (components, types, units, categories) is that of pymtconnect, which was generated from the standard's
model. Prints the first thing that breaks a rule, or a line of JSON with what it knows once a second.

    mtconnect_agent.py DEVICES.xml PORT SECONDS
"""

import json
import re
import socket
import sys
import time
import xml.etree.ElementTree as ET
from datetime import datetime, timezone
from pathlib import Path

import pymtconnect
from pymtconnect.Enums.DataTypes.ConditionEnum import ConditionEnum
from pymtconnect.Enums.DataTypes.DataItemSubTypeEnum import DataItemSubTypeEnum
from pymtconnect.Enums.DataTypes.EventEnum import EventEnum
from pymtconnect.Enums.DataTypes.SampleEnum import SampleEnum
from pymtconnect.Enums.DataTypes.UnitEnum import UnitEnum

NAMESPACE = re.compile(r"^\{urn:mtconnect\.org:MTConnectDevices:\d\.\d\}")
STAMP = re.compile(r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z$")
LEVELS = {"NORMAL", "WARNING", "FAULT", "UNAVAILABLE"}


def names(enum):
    return {str(getattr(it, "value", it)) for it in enum} | {it.name for it in enum}


TYPES = {"SAMPLE": names(SampleEnum), "EVENT": names(EventEnum), "CONDITION": names(ConditionEnum)}
# Of the organizers the model has no classes.
COMPONENTS = {"Axes", "Device"} | {
    it.stem for it in (Path(pymtconnect.__file__).parent / "Classes/ComponentTypes").glob("[A-Z]*.py")
}
SUBTYPES, UNITS = names(DataItemSubTypeEnum), names(UnitEnum)


def read_devices(path):
    """Returns the data items by their identifiers; every rule that is broken is an error."""
    items, ids = {}, set()

    def walk(element, inside):
        assert NAMESPACE.match(element.tag), f"{element.tag}: of another namespace"
        tag = NAMESPACE.sub("", element.tag)
        attributes = element.attrib
        if "id" in attributes:
            assert attributes["id"] not in ids, f"{attributes['id']} stands twice"
            assert re.match(r"^[A-Za-z_][\w.-]*$", attributes["id"]), f"{attributes['id']} is no XML name"
            ids.add(attributes["id"])
        if inside == "Components" or tag == "Device":
            assert tag in COMPONENTS, f"<{tag}> is no component of the standard"
            assert "id" in attributes, f"<{tag}> without an id"
        if tag == "Device":
            assert attributes.get("uuid") and attributes.get("name"), "a device has a uuid and a name"
        if tag == "DataItem":
            kind, category = attributes["type"], attributes["category"]
            assert inside == "DataItems" and category in TYPES
            assert kind in TYPES[category], f"{kind} is no {category} of the standard"
            assert attributes.get("subType", "ACTUAL") in SUBTYPES
            if category == "SAMPLE":
                assert attributes.get("units") in UNITS, f"{attributes.get('units')} is no unit"
            items[attributes["id"]] = attributes
        for child in element:
            walk(child, tag)

    root = ET.parse(path).getroot()
    assert NAMESPACE.sub("", root.tag) == "MTConnectDevices"
    walk(root, None)
    return items


class Agent:
    def __init__(self, items):
        self.items = items
        self.values = {key: "UNAVAILABLE" for key in items if items[key]["category"] != "CONDITION"}
        self.conditions = {key: None for key in items if items[key]["category"] == "CONDITION"}
        self.pongs = self.lines = 0
        self.skew_s = 0.0

    def line(self, text):
        self.lines += 1
        if text.startswith("*"):
            assert re.match(r"^\* PONG \d+$", text), text
            self.pongs += 1
            return
        stamp, *fields = text.split("|")
        assert STAMP.match(stamp), f"no time: {text}"
        said = datetime.fromisoformat(stamp.replace("Z", "+00:00"))
        self.skew_s = max(self.skew_s, abs((datetime.now(timezone.utc) - said).total_seconds()))
        while fields:
            key = fields.pop(0)
            item = self.items.get(key)
            assert item, f"{key} is in no Devices.xml"
            if item["category"] == "CONDITION":
                level, code, _severity, _qualifier, message = fields
                assert level in LEVELS, text
                self.condition(key, level, code, message)
                return
            if item["type"] == "MESSAGE":
                code, message = fields
                self.values[key] = [code, message]
                return
            value = fields.pop(0)
            assert value == "UNAVAILABLE" or item["category"] != "SAMPLE" or float(value) is not None
            self.values[key] = value

    def condition(self, key, level, code, message):
        if level == "UNAVAILABLE":
            self.conditions[key] = None
        elif level == "NORMAL" and not code:
            self.conditions[key] = {}
        elif level == "NORMAL":
            (self.conditions[key] or {}).pop(code, None)
        else:
            active = self.conditions[key] or {}
            active[code] = [level, message]
            self.conditions[key] = active


def main():
    agent = Agent(read_devices(sys.argv[1]))
    end = time.monotonic() + float(sys.argv[3])
    with socket.create_connection(("127.0.0.1", int(sys.argv[2])), timeout=5) as adapter:
        adapter.settimeout(0.1)
        rest, asked = b"", 0.0
        while (now := time.monotonic()) < end:
            if now - asked >= 1:
                adapter.sendall(b"* PING\n")
                asked = now
                print(json.dumps({k: v for k, v in vars(agent).items() if k != "items"}), flush=True)
            try:
                data = adapter.recv(4096)
            except TimeoutError:
                continue
            assert data, "the adapter has left"
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                agent.line(line.decode())
    print(json.dumps({k: v for k, v in vars(agent).items() if k != "items"}), flush=True)


main()
