"""ROS 2 messages of a run, of standard types, by `rosbags`; no ROS is needed.

Lengths are in m and angles in rad, as ROS wants them (REP 103). Stamps are the start of the run (UTC) and the
rig's clock. Topics: `/joint_states` (joints of the rig's URDF), `/tips/FINGER` (PointStamped), `/tf`
(TFMessage: `W` to `part` and `tip-FINGER`), `/arrays/FINGER` (UInt16MultiArray), `/hypotheses` and
`/contacts` (MarkerArray), `/pose` (PoseWithCovarianceStamped of the heaviest hypothesis) and `/events`
(String, JSON). The covariance is that of even distributions over the bounds, which `/events` has.
"""

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from palpate.base.geometry import Floats, ObjectModel
from palpate.base.optional_imports import import_extra
from palpate.config import RigFile
from palpate.recognizer import Contact
from palpate.rig.session.logged_values import LoggedHypothesis
from palpate.rig.session.recorded_session import EventSample, FrameSample, Sample, ServoSample, TipSample
from palpate.views.exports.urdf import joint_values
from palpate.views.run_scene import COLOURS, LogClock, Outline, SceneFeed, SceneSnapshot, frame_of

_FRAME = "W"
_M_PER_MM = 1e-3
_LINE_STRIP, _SPHERE, _ADD, _DELETE_ALL = 4, 2, 0, 3  # visualization_msgs/Marker
_LINE_WIDTH_MM = 0.5
_CONTACT_COLOUR = (0.85, 0.2, 0.2)

Message = tuple[str, float, Any]
"""Topic, time on the rig's clock (s), and a message as `rosbags` has them."""


class RosMessages:
    """Makes the messages of a run, sample by sample; `store`: the types."""

    def __init__(self, rig: RigFile, objects: Sequence[ObjectModel], clock: LogClock, extra: str) -> None:
        """Raises MissingPackageError, which names the extra, without `rosbags`."""
        stores = import_extra("rosbags.typesys", extra, "ROS 2")
        self.store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
        self.clock = clock
        self._feed, self._joints = SceneFeed(rig, objects), joint_values(rig)
        self._part: object = None

    def of(self, sample: Sample) -> Iterator[Message]:
        """Messages of a sample."""
        make, t_s = self._make, sample.t_s
        match sample:
            case ServoSample() if sample.joint in self._joints:
                position = np.array([self._joints[sample.joint](sample.position_rad)])
                yield (
                    "/joint_states",
                    t_s,
                    make(
                        "sensor_msgs/msg/JointState",
                        header=self._header(t_s),
                        name=[sample.joint],
                        position=position,
                        velocity=np.empty(0),
                        effort=np.empty(0),
                    ),
                )
            case TipSample():
                point = self._point(sample.x_mm, sample.y_mm)
                stamped = make("geometry_msgs/msg/PointStamped", header=self._header(t_s), point=point)
                yield f"/tips/{sample.finger}", t_s, stamped
            case FrameSample():
                yield f"/arrays/{sample.finger}", t_s, self._frame(sample)
            case EventSample():
                text = json.dumps({"t_s": t_s, "event": sample.kind} | dict(sample.values))
                yield "/events", t_s, make("std_msgs/msg/String", data=text)
        scene = self._feed.take(sample)
        if scene is not None:
            yield from self._scene(scene, is_event=isinstance(sample, EventSample))

    def _frame(self, sample: FrameSample) -> Any:
        make, (rows, columns) = self._make, sample.frame.counts.shape
        sides = [("row", rows, rows * columns), ("column", columns, columns)]
        dimensions = [
            make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=stride)
            for label, size, stride in sides
        ]
        layout = make("std_msgs/msg/MultiArrayLayout", dim=dimensions, data_offset=0)
        counts = sample.frame.counts.ravel().astype(np.uint16)
        return make("std_msgs/msg/UInt16MultiArray", layout=layout, data=counts)

    def _scene(self, scene: SceneSnapshot, *, is_event: bool) -> Iterator[Message]:
        places = {f"tip-{tip.finger}": (*tip.at_mm, tip.height_mm, 0.0) for tip in scene.tips}
        for item in scene.parts:
            at = item.configuration
            places[frame_of(item)] = at.x_mm, at.y_mm, 0.0, at.theta_rad
        transforms = [self._transform(scene.t_s, name, *place) for name, place in places.items()]
        yield "/tf", scene.t_s, self._make("tf2_msgs/msg/TFMessage", transforms=transforms)
        if not is_event:
            return
        part = scene.parts[0] if scene.parts else None
        if part is not None and part is not self._part:
            yield "/pose", scene.t_s, self._pose_in_bounds(scene.t_s, part)
        self._part = part
        lines = [(item.kind == "normal", self._line(scene.t_s, item)) for item in scene.outlines]
        touched = [place for touch in scene.touches for place in touch.places if place.touched]
        spheres = [self._tip(scene.t_s, place) for place in touched]
        for topic, markers in (
            ("/hypotheses", [line for is_normal, line in lines if not is_normal]),
            ("/contacts", [*spheres, *(line for is_normal, line in lines if is_normal)]),
        ):
            for number, marker in enumerate(markers):
                marker.id = number
            clear = self._marker(scene.t_s, "", action=_DELETE_ALL)
            array = self._make("visualization_msgs/msg/MarkerArray", markers=[clear, *markers])
            yield topic, scene.t_s, array

    def _transform(self, t_s: float, name: str, x_mm: float, y_mm: float, z_mm: float, turn: float) -> Any:
        x, y, z = (_M_PER_MM * value for value in (x_mm, y_mm, z_mm))
        move = self._make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
        transform = self._make("geometry_msgs/msg/Transform", translation=move, rotation=self._turn(turn))
        kind, header = "geometry_msgs/msg/TransformStamped", self._header(t_s)
        return self._make(kind, header=header, child_frame_id=name, transform=transform)

    def _pose_in_bounds(self, t_s: float, item: LoggedHypothesis) -> Any:
        at, bounds = item.configuration, item.bounds
        pose = self._pose(at.x_mm, at.y_mm, 0.0, at.theta_rad)
        covariance = np.zeros((6, 6))  # of x, y, z and the turns about them
        for k, value, (lo, hi), unit in (
            (0, at.x_mm, bounds.x_mm, _M_PER_MM),
            (1, at.y_mm, bounds.y_mm, _M_PER_MM),
            (5, at.theta_rad, bounds.theta_rad, 1.0),
        ):
            covariance[k, k] = (max(hi - value, value - lo) * unit) ** 2 / 3
        kind = "geometry_msgs/msg/PoseWithCovariance"
        uncertain = self._make(kind, pose=pose, covariance=covariance.ravel())
        return self._make(f"{kind}Stamped", header=self._header(t_s), pose=uncertain)

    def _line(self, t_s: float, item: Outline) -> Any:
        ring: Floats = item.points_mm
        closed = np.vstack([ring, ring[:1]]) if item.is_closed and len(ring) else ring
        return self._marker(
            t_s,
            item.kind,
            type=_LINE_STRIP,
            scale=self._size(_LINE_WIDTH_MM, 0.0),
            color=self._colour(*COLOURS[item.kind], 1.0),
            points=[self._point(x, y, item.height_mm) for x, y in closed.tolist()],
            text=item.name,
        )

    def _tip(self, t_s: float, place: Contact) -> Any:
        """The tip where it touched."""
        across = 2 * max(place.finger.tip_radius_mm, 1.0)
        return self._marker(
            t_s,
            "contact",
            type=_SPHERE,
            pose=self._pose(*place.end_mm, place.finger.height_mm, 0.0),
            scale=self._size(across, across),
            color=self._colour(*_CONTACT_COLOUR, 0.5),
            text=place.name,
        )

    def _marker(self, t_s: float, namespace: str, **fields: object) -> Any:
        make, nothing = self._make, np.empty(0, np.uint8)
        image = "sensor_msgs/msg/CompressedImage"
        unset = {
            **{"id": 0, "type": 0, "action": _ADD, "frame_locked": False, "text": ""},
            **{"points": [], "colors": [], "uv_coordinates": [], "texture_resource": "", "mesh_resource": ""},
            "pose": self._pose(0.0, 0.0, 0.0, 0.0),
            "scale": self._size(0.0, 0.0),
            "color": self._colour(0.0, 0.0, 0.0, 0.0),
            "lifetime": make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            "texture": make(image, header=self._header(t_s), format="", data=nothing),
            "mesh_file": make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
            "mesh_use_embedded_materials": False,
        }
        kind, header = "visualization_msgs/msg/Marker", self._header(t_s)
        return make(kind, header=header, ns=namespace, **(unset | fields))

    def _size(self, x_mm: float, others_mm: float) -> Any:
        x, other = x_mm * _M_PER_MM, others_mm * _M_PER_MM
        return self._make("geometry_msgs/msg/Vector3", x=x, y=other, z=other)

    def _colour(self, red: float, green: float, blue: float, alpha: float) -> Any:
        return self._make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha)

    def _point(self, x_mm: float, y_mm: float, z_mm: float = 0.0) -> Any:
        x, y, z = (_M_PER_MM * value for value in (x_mm, y_mm, z_mm))
        return self._make("geometry_msgs/msg/Point", x=x, y=y, z=z)

    def _pose(self, x_mm: float, y_mm: float, z_mm: float, turn_rad: float) -> Any:
        place = self._point(x_mm, y_mm, z_mm)
        return self._make("geometry_msgs/msg/Pose", position=place, orientation=self._turn(turn_rad))

    def _turn(self, about_z_rad: float) -> Any:
        half = about_z_rad / 2
        return self._make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))

    def _header(self, t_s: float) -> Any:
        seconds, rest = divmod(self.clock.ns(t_s), 10**9)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=_FRAME)

    def _make(self, kind: str, **fields: object) -> Any:
        return self.store.types[kind](**fields)
