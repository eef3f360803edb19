"""A run that others follow: by a client of Foxglove's websocket protocol, and by a rosbridge."""

import json
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from palpate.views.live.publishing import _Rosbridge
from support.benches.rigs import quick_bench
from support.commands.command import PATIENCE_S, Started, started, until

websocket = pytest.importorskip("websocket", reason="websocket-client is not installed")


@contextmanager
def free_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    yield port


@contextmanager
def a_run(folder: Path, *options: object) -> Iterator[Started]:
    rig, objects = quick_bench(folder)
    words = ("identify", "--rig", rig, "--objects", objects, "--seed", 7, *options)
    with started(*words, cwd=folder) as run:
        yield run


def test_foxglove_sees_the_run_with_the_schemas_of_mcap_files(tmp_path: Path) -> None:
    """A client that is not of the SDK subscribes to all channels; JSON is what its schema says."""
    kept: list[tuple[dict[str, Any], bytes]] = []
    with free_port() as port, a_run(tmp_path, "--foxglove", "--foxglove-port", port) as run:
        address = f"ws://127.0.0.1:{port}/"

        def connect() -> Any:
            try:
                return websocket.create_connection(address, 5, subprotocols=["foxglove.sdk.v1"])
            except OSError:
                return None

        client = run.until(connect)
        channels: dict[int, dict[str, Any]] = {}
        with suppress(websocket.WebSocketException, OSError):
            while True:
                kind, data = client.recv_data()
                if kind == websocket.ABNF.OPCODE_BINARY and data[0] == 1:
                    (number,) = struct.unpack_from("<I", data, 1)
                    kept.append((channels[number], data[13:]))
                elif kind == websocket.ABNF.OPCODE_TEXT:
                    said = json.loads(data)
                    new = {item["id"]: item for item in said.get("channels", ()) if said["op"] == "advertise"}
                    channels |= new
                    subscriptions = [{"id": number, "channelId": number} for number in new]
                    client.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        ended = run.ended()
    assert ended.code == 0, ended.err
    assert f"ws://127.0.0.1:{port}" in ended.err
    topics = {channel["topic"] for channel, _ in kept}
    assert {
        "/scene",
        "/tf",
        "/arrays/f1",
        "/servos/f1_aim",
        "/contacts",
        "/verdicts",
        "/events/end",
    } <= topics
    for channel in channels.values():
        assert channel["schemaName"]
        assert channel["schema"]
        if channel["encoding"] == "json":
            judge = Draft202012Validator(json.loads(channel["schema"]))
            sent = [data for own, data in kept if own is channel]
            # Of thousands of frames and servo states, all of one form, every fiftieth.
            values = [json.loads(data) for data in (*sent[:50], *sent[50::50])]
            assert [error.message for value in values for error in judge.iter_errors(value)] == []


class Bridge:
    """A rosbridge without ROS: takes what is advertised and published, as protocol v2.1 has it."""

    def __init__(self, port: int) -> None:
        from websockets.sync.server import serve

        self.types: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self.last: dict[str, Any] = {}
        self.faults: list[str] = []
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self.server = serve(self._serve, "127.0.0.1", port)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def _serve(self, connection: Any) -> None:
        for text in connection:
            said = json.loads(text)
            topic = said["topic"]
            if said["op"] == "advertise":
                self.types[topic] = said["type"]
            elif said["op"] == "publish":
                self._check(self.types[topic], said["msg"], topic)
                self.counts[topic] += 1
                self.last[topic] = said["msg"]
            else:
                self.faults.append(text)

    def _check(self, kind: str, value: Any, place: str) -> None:
        """Note what is not as the message's definition says: a field that lacks, or is none of its."""
        fields = dict(self._store.fielddefs[kind][1])
        if not isinstance(value, Mapping) or value.keys() != fields.keys():
            self.faults.append(f"{place}: {value}")
            return
        for name, (node, of) in fields.items():
            is_list = node in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            item_node, item_of = of[0] if is_list else (node, of)
            for item in value[name] if is_list else [value[name]]:
                if item_node == Nodetype.NAME:
                    self._check(item_of, item, f"{place}.{name}")
                elif not isinstance(item, str if item_of[0] == "string" else int | float):
                    self.faults.append(f"{place}.{name}: {item!r}")


def test_ros_gets_standard_messages_without_ros_on_this_side(tmp_path: Path) -> None:
    pytest.importorskip("websockets", reason="websockets is not installed: pip install websockets")
    with free_port() as port:
        bridge = Bridge(port)
        with a_run(tmp_path, "--ros", f"127.0.0.1:{port}", "--json") as run:
            ended = run.ended()
        until(lambda: any('"end"' in text for text in [bridge.last.get("/events", {}).get("data", "")]))
        bridge.server.shutdown()
    assert ended.code == 0, ended.err
    assert bridge.faults == []
    assert bridge.types == {
        **dict.fromkeys(["/tips/f1", "/tips/f2", "/tips/f3"], "geometry_msgs/msg/PointStamped"),
        **dict.fromkeys(["/arrays/f1", "/arrays/f2", "/arrays/f3"], "std_msgs/msg/UInt16MultiArray"),
        **dict.fromkeys(["/hypotheses", "/contacts"], "visualization_msgs/msg/MarkerArray"),
        "/joint_states": "sensor_msgs/msg/JointState",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/events": "std_msgs/msg/String",
    }
    found, pose = json.loads(ended.out), bridge.last["/pose"]["pose"]
    assert pose["pose"]["position"]["x"] == pytest.approx(found["configuration"]["x"] * 1e-3)
    half = max(abs(end - found["configuration"]["x"]) for end in found["bounds"]["x"]) * 1e-3
    assert pose["covariance"][0] == pytest.approx(half**2 / 3)
    touched = [item for item in bridge.last["/contacts"]["markers"] if item["ns"] == "contact"]
    assert len(touched) == found["contacts"]
    frames = {item["child_frame_id"] for item in bridge.last["/tf"]["transforms"]}
    assert frames == {"tip-f1", "tip-f2", "tip-f3", "part"}


def test_a_bridge_that_takes_nothing_costs_messages_and_nothing_else() -> None:
    """Nobody answers the websocket's greeting; what is published meanwhile is lost at once."""
    pytest.importorskip("websockets", reason="websockets is not installed: pip install websockets")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        bridge = _Rosbridge(f"127.0.0.1:{silent.getsockname()[1]}", lambda _: None)
        begin = time.monotonic()
        for _ in range(1000):
            bridge.publish("/events", None)
        assert time.monotonic() - begin < PATIENCE_S / 10
        bridge.close()


@pytest.mark.parametrize("address", ["nowhere", "127.0.0.1:x", "127.0.0.1:1"])
def test_ros_is_refused_before_anything_moves(
    address: str, here: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: True)
    ended = here("identify", "--ros", address)
    assert (ended.code, ended.out) == (2, "")
    assert f"--ros {address}" in ended.err
