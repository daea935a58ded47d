"""A Sparkplug host application by pysparkplug, and a subscriber with a session that lasts, by paho.

Prints a line of JSON for each message: what it is, its sequence number, its metrics by name. Reads commands from its
standard input: "rebirth NODE", "online HOST", "offline HOST", "raw TOPIC HEX".
"""

import json
import sys
import threading
import time

import pysparkplug as psp
from google.protobuf.message import DecodeError
from paho.mqtt import client as paho
from pysparkplug import _protobuf as protobuf

PORT = int(sys.argv[1])
LOCK = threading.Lock()


def say(**members):
    with LOCK:
        print(json.dumps(members), flush=True)


def plain(value):
    return value if isinstance(value, (int, float, str, bool, type(None))) else str(value)


def rebirth(node):
    """Asks an edge node for all its births."""
    metric = psp.Metric(
        timestamp=psp.get_current_timestamp(),
        name="Node Control/Rebirth",
        datatype=psp.DataType.BOOLEAN,
        value=True,
    )
    topic = psp.Topic(group_id="trueup", message_type=psp.MessageType.NCMD, edge_node_id=node)
    payload = psp.NCmd(timestamp=psp.get_current_timestamp(), metrics=(metric,))
    host.publish(
        psp.Message(topic=topic, payload=payload, qos=psp.QoS.AT_MOST_ONCE, retain=False), include_dtypes=True
    )


class Host(psp.Client):
    """A client that comes late knows no birth; as a host must, it asks for them."""

    def _handle_message(self, mqtt_message):
        try:
            return super()._handle_message(mqtt_message)
        except (KeyError, NotImplementedError):
            rebirth(mqtt_message.topic.split("/")[3])
            return None
        except (DecodeError, ValueError):
            # What the tests send to the publisher comes back here too.
            return None


def message(_client, it):
    if it is None:
        return
    payload, topic = it.payload, it.topic
    metrics = {m.name: plain(m.value) for m in getattr(payload, "metrics", ())}
    if (bd_seq := getattr(payload, "bd_seq_metric", None)) is not None:
        metrics["bdSeq"] = bd_seq.value
    say(
        what=str(topic.message_type.value),
        node=topic.edge_node_id,
        device=topic.device_id,
        seq=getattr(payload, "seq", None),
        metrics=metrics,
    )


def record(_client, _data, it):
    payload = protobuf.Payload.FromString(it.payload)
    metrics = {m.name: plain(getattr(m, m.WhichOneof("value") or "is_null")) for m in payload.metrics}
    units = {
        m.name: v.string_value
        for m in payload.metrics
        for k, v in zip(m.properties.keys, m.properties.values)
        if k == "engUnit"
    }
    say(what="record", topic=it.topic, id=payload.uuid, retained=bool(it.retain), metrics=metrics, units=units)


def birth_units(_client, _data, it):
    payload = protobuf.Payload.FromString(it.payload)
    units = {
        m.name: v.string_value
        for m in payload.metrics
        for k, v in zip(m.properties.keys, m.properties.values)
        if k == "engUnit"
    }
    say(what="units", topic=it.topic, units=units)


# The subscriber that misses nothing while it, or the broker, is away.
keeper = paho.Client(client_id="keeper", clean_session=False)
keeper.reconnect_delay_set(min_delay=1, max_delay=1)
subscribed = threading.Event()
keeper.message_callback_add("spBv1.0/trueup/DBIRTH/#", birth_units)
keeper.on_message = record
keeper.on_connect = lambda c, *_: c.subscribe([("trueup/#", 1), ("spBv1.0/trueup/DBIRTH/#", 0)])
keeper.on_subscribe = lambda *_: subscribed.set()
keeper.connect("127.0.0.1", PORT)
keeper.loop_start()
subscribed.wait(20)

host = Host(client_options=psp.ClientOptions(reconnection_delay_min=1, reconnection_delay_max=1))
host.subscribe(psp.Topic(group_id="trueup", message_type="+", edge_node_id="#"), psp.QoS.AT_MOST_ONCE, message)
ready = threading.Event()
host.connect("127.0.0.1", port=PORT, callback=lambda _c: ready.set())
ready.wait(20)
time.sleep(0.5)
say(what="connected")

for line in sys.stdin:
    command, *rest = line.split()
    if command == "rebirth":
        rebirth(rest[0])
    elif command in ("online", "offline"):
        state = {"online": command == "online", "timestamp": int(1000 * time.time())}
        keeper.publish(f"spBv1.0/STATE/{rest[0]}", json.dumps(state), qos=1, retain=True)
    elif command == "raw":
        keeper.publish(rest[0], bytes.fromhex(rest[1]) if len(rest) > 1 else b"", qos=0)
