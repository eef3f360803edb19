"""Exports of a session, read back by others: `mcap` with protobuf, `rosbags`, and the csv module."""

import csv
import json
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from palpate.config import load_rig
from palpate.config.schema import schema_text
from palpate.drivers.dynamixel.bus import GroupRead
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.servo_state import ServoState, StateReader
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.recorded_session import FrameSample, ServoSample, TipSample, open_samples
from palpate.views.numerals import at_least, at_most
from palpate.views.svg import TIP_FILL
from support.benches.rigs import RUNS
from support.campaign.sampling import sample
from support.commands.command import Here, log_events, missing, violations

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def states() -> list[tuple[int, float]]:
    """ID and angle (rad) of every state that the run has read, once it is over."""
    return []


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, states: list[tuple[int, float]]) -> Path:
    read = StateReader.read

    def noted(reader: StateReader, servos: Sequence[Servo]) -> GroupRead[ServoState]:
        found = read(reader, servos)
        states.extend((dxl_id, state.position_rad) for dxl_id, state in found.values.items())
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StateReader, "read", noted)
        return RUNS["two grips"](tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def events(session: Path) -> list[dict[str, Any]]:
    """Everything in the log but bytes."""
    return [item for item in log_events(session / "session.jsonl.zst") if item["event"] not in _NO_EVENTS]


_NO_EVENTS = ("bytes", "opened", "raised")


@pytest.fixture(scope="module")
def frames(session: Path) -> Counter[str]:
    """Frames of each array in the log, counted by what ends each message on the wire."""
    received: dict[str, int] = {}
    file = read_session(session)
    for entry in file.entries:
        data, port = getattr(entry.what, "data", b""), getattr(entry.what, "port", "")
        if data and entry.what.direction.value == "received" and port != "mock://bus":
            received[port] = received.get(port, 0) + data.count(b"\0")
    return Counter({port.removeprefix("mock://"): count for port, count in received.items()})


def test_every_state_that_was_read_is_a_sample(session: Path, states: list[tuple[int, float]]) -> None:
    samples = open_samples(read_session(session), session)
    found = [(item.dxl_id, item.position_rad) for item in samples if isinstance(item, ServoSample)]
    assert len(states) > 1000
    assert Counter(found) == Counter(states)


def test_servos_are_where_the_touches_say(session: Path, events: list[dict[str, Any]]) -> None:
    samples = list(open_samples(read_session(session), session))
    assert all(one.t_s <= other.t_s for one, other in pairwise(samples))
    servos = [item for item in samples if isinstance(item, ServoSample)]
    tips = [item for item in samples if isinstance(item, TipSample)]
    fingers = load_rig(session / "rig.toml").fingers
    for event in events:
        for touch in event.get("touches", ()):
            finger = fingers[touch["finger_index"]]
            joints = [f"{finger.name}_{joint}" for joint in finger.servos]
            for joint, angle in zip(joints, touch["servos"], strict=True):
                known = [item.position_rad for item in servos if item.joint == joint]
                assert min(abs(np.array(known) - angle)) < 1e-9
            end = np.array(touch["contact"]["end_mm"])
            reached = [(item.x_mm, item.y_mm) for item in tips if item.finger == finger.name]
            assert np.hypot(*(np.array(reached) - end).T).min() < 1.0


def test_every_frame_is_a_sample(session: Path, frames: Counter[str]) -> None:
    samples = open_samples(read_session(session), session)
    found = Counter(item.finger for item in samples if isinstance(item, FrameSample))
    assert found.keys() == frames.keys()
    for name, count in found.items():
        assert frames[name] - 40 <= count <= frames[name], "but for answers, and what came before START"


def test_an_mcap_file_holds_what_the_log_holds(
    session: Path, tmp_path: Path, here: Here, events: list[dict[str, Any]]
) -> None:
    ended = here("export", session, "--mcap", "run.mcap", "--json")
    assert (ended.code, ended.err.strip()) == (0, "")
    assert violations(ended.json["format"], {"const": "palpate/export@1"}) == []
    (said,) = ended.json["written"]
    topics: Counter[str] = Counter()
    times: dict[str, list[int]] = {}
    kinds: Counter[str] = Counter()
    decoded_by_topic: dict[str, list[Any]] = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for schema, channel, message in make_reader(file).iter_messages():
            topics[channel.topic] += 1
            times.setdefault(channel.topic, []).append(message.log_time)
            if channel.message_encoding == "json":
                kinds[json.loads(message.data).get("event")] += 1
            else:
                assert schema is not None
                assert schema.name == f"foxglove.{OWN_SCHEMAS[channel.topic]}"
        for _, channel, _, decoded in reader.iter_decoded_messages(topics=["/scene", "/tf", "/pose"]):
            decoded_by_topic.setdefault(channel.topic, []).append(decoded)
    assert topics == said["messages"]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(topics.values())
    assert {topic.split("/")[1] for topic in topics} == {
        *("scene", "tf", "pose", "arrays", "tips", "servos", "contacts", "verdicts", "events")
    }
    logged = Counter(event["event"] for event in events)
    assert {kind: kinds[kind] for kind in logged} == logged
    for instants in times.values():
        assert instants == sorted(instants)
    assert all(abs(lists[0] - lists[-1]) < 300e9 for lists in times.values())
    last = decoded_by_topic["/scene"][-1]
    names = {entity.id for entity in last.entities}
    assert {"workspace", "truth-0-0", "hypothesis-0-0", "tip-f1", "tip-f2", "tip-f3"} <= names
    (truth,) = [entity for entity in last.entities if entity.id == "truth-0-0"]
    (found,) = [entity for entity in last.entities if entity.id == "hypothesis-0-0"]
    middles = [np.mean([(p.x, p.y) for p in item.lines[0].points], axis=0) for item in (truth, found)]
    assert np.hypot(*(middles[0] - middles[1])) < 1e-3, "in m"
    (result,) = [event["result"] for event in events if event["event"] == "result"]
    at, pose = result["configuration"], decoded_by_topic["/pose"][-1].pose
    found_theta = 2 * np.arctan2(pose.orientation.z, pose.orientation.w)
    assert (pose.position.x * 1e3, pose.position.y * 1e3) == pytest.approx((at["x"], at["y"]))
    assert np.cos(found_theta - at["theta"]) == pytest.approx(1.0)
    frames = {item.child_frame_id: item.parent_frame_id for item in decoded_by_topic["/tf"][-1].transforms}
    assert frames == dict.fromkeys(["tip-f1", "tip-f2", "tip-f3", "part"], "W")


OWN_SCHEMAS = {"/scene": "SceneUpdate", "/tf": "FrameTransforms", "/pose": "PoseInFrame"}


def check_viewable(schema: dict[str, Any], place: str) -> None:
    """Foxglove's and Lichtblick's parser refuses all other schemas, and then shows nothing of a channel."""
    match schema["type"]:
        case "object":
            for name, part in schema["properties"].items():
                check_viewable(part, f"{place}.{name}")
        case "array":
            assert schema["items"]["type"] != "array", place
            check_viewable(schema["items"], f"{place}[]")
        case kind:
            assert kind in ("boolean", "string", "number", "integer"), place


def undescribed(schema: dict[str, Any], value: object, place: str) -> set[str]:
    """Keys that the schema does not have."""
    if isinstance(value, list):
        return {name for item in value for name in undescribed(schema["items"], item, f"{place}[]")}
    if not isinstance(value, dict):
        return set()
    known = schema["properties"]
    found = {f"{place}.{name}" for name in value if name not in known}
    return found.union(
        *(undescribed(known[name], value[name], f"{place}.{name}") for name in value if name in known)
    )


@pytest.mark.parametrize("run", sample(["two grips", "two grips with pads"], ["two grips"]))
def test_every_json_message_is_what_its_schema_says(
    run: str, request: pytest.FixtureRequest, tmp_path: Path, here: Here
) -> None:
    kept = request.getfixturevalue("session") if run == "two grips" else RUNS[run](tmp_path)
    assert here("export", kept, "--mcap", "run.mcap").code == 0
    validators: dict[str, Draft202012Validator] = {}
    seen: Counter[str] = Counter()
    with (tmp_path / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            seen[channel.topic] += 1
            # Of tens of thousands of frames and servo states, all of one form, every fiftieth.
            if channel.message_encoding != "json" or (seen[channel.topic] > 50 and seen[channel.topic] % 50):
                continue
            if channel.topic not in validators:
                text = json.loads(schema.data)
                Draft202012Validator.check_schema(text)
                check_viewable(text, channel.topic)
                validators[channel.topic] = Draft202012Validator(text)
            judge, value = validators[channel.topic], json.loads(message.data)
            assert [error.message for error in judge.iter_errors(value)] == []
            assert undescribed(judge.schema, value, channel.topic) == set()
    assert {"/contacts", "/verdicts", "/events/result", "/arrays/f1", "/servos/f1_aim"} <= validators.keys()


def test_a_bag_is_read_back_by_rosbags(
    session: Path, tmp_path: Path, here: Here, events: list[dict[str, Any]]
) -> None:
    ended = here("export", session, "--rosbag", "bag", "--json")
    assert ended.code == 0
    (said,) = ended.json["written"]
    counts: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            counts[connection.topic] += 1
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/events":
                kinds[json.loads(message.data)["event"]] += 1
            elif connection.topic.startswith("/arrays/"):
                sizes = [item.size for item in message.layout.dim]
                assert np.prod(sizes) == len(message.data)
            elif connection.topic == "/pose":
                turn = message.pose.pose.orientation
                assert turn.z**2 + turn.w**2 == pytest.approx(1.0)
        assert {connection.msgtype.split("/")[0] for connection in reader.connections} == {
            *("sensor_msgs", "geometry_msgs", "std_msgs", "tf2_msgs", "visualization_msgs")
        }
    assert counts == said["messages"]
    assert counts["/pose"] == sum(bool(event.get("hypotheses") or event.get("result")) for event in events)
    logged = Counter(event["event"] for event in events)
    assert {kind: kinds[kind] for kind in logged} == logged


def test_csv_files_have_their_units_in_their_headers_and_a_line_for_each_sample(
    session: Path, tmp_path: Path, here: Here, events: list[dict[str, Any]]
) -> None:
    ended = here("export", session, "--csv", "tables")
    assert ended.code == 0
    tables = {}
    for path in (tmp_path / "tables").iterdir():
        with path.open(newline="") as file:
            tables[path.stem] = list(csv.DictReader(file))
    assert {"servos", "tips", "array-f1", "contacts", "hypotheses", "events"} <= tables.keys()
    assert len(tables["events"]) == len(events)
    touched = [touch for event in events for touch in event.get("touches", ())]
    assert [row["finger"] for row in tables["contacts"]] == [item["contact"]["name"] for item in touched]
    ends = [item["contact"]["end_mm"] for item in touched]
    assert [[float(row["x_mm"]), float(row["y_mm"])] for row in tables["contacts"]] == ends
    (result,) = [event["result"] for event in events if event["event"] == "result"]
    answers = [row for row in tables["hypotheses"] if not row["grip"]]
    assert len(answers) == 1 + len(result["alternatives"])
    place = {name.split("_")[0]: float(answers[0][name]) for name in ("x_mm", "y_mm", "theta_rad")}
    assert (place, answers[0]["verdict"]) == (result["configuration"], result["verdict"])
    assert sum(name.startswith("taxel_") for name in tables["array-f1"][0]) == 160
    assert f"tables: {sum(map(len, tables.values()))} messages on {len(tables)} topics" in ended.out


def test_nothing_is_overwritten_and_something_must_be_asked_for(
    session: Path, tmp_path: Path, here: Here
) -> None:
    (tmp_path / "there.mcap").write_text("of somebody")
    for option in ("--mcap", "--rosbag"):
        ended = here("export", session, option, "there.mcap")
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert "there.mcap is there already" in ended.err
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note.txt").write_text("")
    assert "full is there already" in here("export", session, "--csv", "full").err
    assert not missing(here("export", session).err, "--mcap", "--csv", "--rosbag", "--animation", "--urdf")
    assert (tmp_path / "there.mcap").read_text() == "of somebody"


def test_the_schema_of_the_result_is_published() -> None:
    assert json.loads(schema_text("export"))["properties"]["format"]["const"] == "palpate/export@1"


def test_a_moving_picture_tells_the_run(
    session: Path, tmp_path: Path, here: Here, events: list[dict[str, Any]]
) -> None:
    """Every touch and hypothesis is drawn from its event on, and so are the fingers and the bounds."""
    ended = here("export", session, "--animation", "run.svg")
    assert (ended.code, ended.out.strip()) == (0, "run.svg")
    drawn = ET.parse(tmp_path / "run.svg").getroot()
    moving = [item for item in drawn.iter() if item.tag.endswith("animate")]
    assert {item.get("repeatCount") for item in moving} == {"indefinite"}
    for item in moving:
        times = [float(share) for share in item.get("keyTimes", "").split(";")]
        assert times[0] == 0
        assert times[-1] == 1
        assert times == sorted(times)
        assert len(times) == len(item.get("values", "").split(";"))
    touched = [touch for event in events for touch in event.get("touches", ())]
    contacts = [item for item in drawn.iter(f"{SVG}circle") if item.get("fill") == TIP_FILL]
    assert len(contacts) == sum(touch["contact"]["touched"] for touch in touched)
    (result,) = [event["result"] for event in events if event["event"] == "result"]
    words = " ".join("".join(item.itertext()) for item in drawn.iter(f"{SVG}text"))
    for lo, hi in (result["bounds"]["x"], result["bounds"]["y"]):
        assert f"[{at_least(lo)}, {at_most(hi)}]" in words
    tips = [item for item in drawn.iter(f"{SVG}circle") if item.find(f"{SVG}animate") is not None]
    assert len(tips) == len(load_rig(session / "rig.toml").fingers)
