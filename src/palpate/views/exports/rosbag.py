"""ROS 2 bag export of a session, of standard messages, by `rosbags`; no ROS is needed.

Lengths are in m and angles in rad, as ROS wants them (REP 103). Stamps are the start of the run (UTC) and the
rig's clock.
"""

import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.base.errors import InputError, OutputError
from palpate.base.optional_imports import import_extra
from palpate.rig.session.logged_values import LoggedHypothesis, hypotheses_in, sort_by_weight
from palpate.rig.session.recorded_session import (
    EventSample,
    FrameSample,
    Sample,
    ServoSample,
    SessionSamples,
    TipSample,
)
from palpate.views.run_scene import COLOURS, LogClock, Outline, SceneFeed, SceneSnapshot

_FRAME = "W"
_M_PER_MM = 1e-3
_PURPOSE = "writing ROS 2 bags"
_BAG_VERSION = 9
_LINE_STRIP, _ADD, _DELETE_ALL = 4, 0, 3  # visualization_msgs/Marker


def write_rosbag(samples: SessionSamples, folder: Path) -> dict[str, int]:
    """Write a session as a ROS 2 bag; the number of messages on each topic.

    Topics: `/joint_states`, `/tips/FINGER` (PointStamped), `/arrays/FINGER` (UInt16MultiArray), `/hypotheses`
    (MarkerArray), `/answer` (PoseStamped, the heaviest hypothesis), `/events` (String, JSON). Raises
    InputError if the folder is there already or `rosbags` is missing, OutputError if it cannot be written.
    """
    if folder.exists():
        raise InputError(f"{folder} is there already: choose another name, or remove it")
    try:
        return _Writer(folder, LogClock.of(samples.started)).write(samples)
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror or error}") from error


class _Writer:
    def __init__(self, folder: Path, clock: LogClock) -> None:
        stores = import_extra("rosbags.typesys", "export", _PURPOSE)
        self._rosbag2 = import_extra("rosbags.rosbag2", "export", _PURPOSE)
        self._store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
        self._folder, self._clock = folder, clock
        self._counts: Counter[str] = Counter()
        self._connections: dict[str, Any] = {}

    def write(self, samples: SessionSamples) -> dict[str, int]:
        with self._rosbag2.Writer(self._folder, version=_BAG_VERSION) as self._bag:
            feed = SceneFeed(samples.rig, samples.objects)
            for sample in samples:
                self._log(sample)
                if isinstance(sample, EventSample) and (scene := feed.take(sample)) is not None:
                    self._markers(scene)
        return dict(self._counts)

    def _put(self, topic: str, t_s: float, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._bag.add_connection(topic, kind, typestore=self._store)
        self._bag.write(
            self._connections[topic], self._clock.ns(t_s), self._store.serialize_cdr(message, kind)
        )
        self._counts[topic] += 1

    def _log(self, sample: Sample) -> None:
        make = self._make
        match sample:
            case ServoSample():
                message = make(
                    "sensor_msgs/msg/JointState",
                    header=self._header(sample.t_s),
                    name=[sample.joint],
                    position=np.array([sample.position_rad]),
                    velocity=np.array([sample.velocity_rad_s]),
                    effort=np.empty(0),
                )
                self._put("/joint_states", sample.t_s, message)
            case TipSample():
                point = make(
                    "geometry_msgs/msg/Point", x=sample.x_mm * _M_PER_MM, y=sample.y_mm * _M_PER_MM, z=0.0
                )
                stamped = make("geometry_msgs/msg/PointStamped", header=self._header(sample.t_s), point=point)
                self._put(f"/tips/{sample.finger}", sample.t_s, stamped)
            case FrameSample():
                rows, columns = sample.frame.counts.shape
                sides = [("row", rows, rows * columns), ("column", columns, columns)]
                dimensions = [
                    make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=stride)
                    for label, size, stride in sides
                ]
                layout = make("std_msgs/msg/MultiArrayLayout", dim=dimensions, data_offset=0)
                counts = sample.frame.counts.ravel().astype(np.uint16)
                self._put(
                    f"/arrays/{sample.finger}",
                    sample.t_s,
                    make("std_msgs/msg/UInt16MultiArray", layout=layout, data=counts),
                )
            case EventSample():
                text = json.dumps({"t_s": sample.t_s, "event": sample.kind} | dict(sample.values))
                self._put("/events", sample.t_s, make("std_msgs/msg/String", data=text))
                if sample.kind in ("recognised", "result"):
                    self._answer(sample.t_s, hypotheses_in(sample.kind, sample.values))

    def _answer(self, t_s: float, hypotheses: Sequence[LoggedHypothesis]) -> None:
        if not hypotheses:
            return
        at = sort_by_weight(hypotheses)[0].configuration
        make, half = self._make, at.theta_rad / 2
        place = make("geometry_msgs/msg/Point", x=at.x_mm * _M_PER_MM, y=at.y_mm * _M_PER_MM, z=0.0)
        turn = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
        pose = make("geometry_msgs/msg/Pose", position=place, orientation=turn)
        self._put("/answer", t_s, make("geometry_msgs/msg/PoseStamped", header=self._header(t_s), pose=pose))

    def _markers(self, scene: SceneSnapshot) -> None:
        clear = self._marker(scene.t_s, Outline("", "workspace", np.empty((0, 2)), 0.0), 0, _DELETE_ALL)
        drawn = [self._marker(scene.t_s, item, number, _ADD) for number, item in enumerate(scene.outlines)]
        message = self._make("visualization_msgs/msg/MarkerArray", markers=[clear, *drawn])
        self._put("/hypotheses", scene.t_s, message)

    def _marker(self, t_s: float, item: Outline, number: int, action: int) -> Any:
        make = self._make
        ring = item.points_mm * _M_PER_MM
        closed = np.vstack([ring, ring[:1]]) if item.is_closed and len(ring) else ring
        z = item.height_mm * _M_PER_MM
        red, green, blue = COLOURS[item.kind]
        zero = make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
        level = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        return make(
            "visualization_msgs/msg/Marker",
            header=self._header(t_s),
            ns=item.kind,
            id=number,
            type=_LINE_STRIP,
            action=action,
            pose=make("geometry_msgs/msg/Pose", position=zero, orientation=level),
            scale=make("geometry_msgs/msg/Vector3", x=0.5 * _M_PER_MM, y=0.0, z=0.0),
            color=make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
            lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=[make("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y in closed.tolist()],
            colors=[],
            texture_resource="",
            texture=make(
                "sensor_msgs/msg/CompressedImage",
                header=self._header(t_s),
                format="",
                data=np.empty(0, np.uint8),
            ),
            uv_coordinates=[],
            text=item.name,
            mesh_resource="",
            mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=np.empty(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )

    def _header(self, t_s: float) -> Any:
        seconds, rest = divmod(self._clock.ns(t_s), 10**9)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=_FRAME)

    def _make(self, kind: str, **fields: object) -> Any:
        return self._store.types[kind](**fields)
