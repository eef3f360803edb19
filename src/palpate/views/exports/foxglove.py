"""Channels of a run for Foxglove and Lichtblick, by Foxglove's SDK: into an MCAP file, or live.

`/scene` (SceneUpdate), `/tf` (FrameTransforms of the tips and the part) and `/pose` (PoseInFrame of the
heaviest hypothesis) have Foxglove's own schemas, so that viewers show a run without any setting; the rest is
JSON. Shapes are in m, as viewers want them; the JSON channels keep the log's units, which their keys name.
Log time is the start of the run (UTC) and the rig's clock.
"""

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError, OutputError
from palpate.base.geometry import ObjectModel
from palpate.base.optional_imports import import_extra
from palpate.config import RigFile
from palpate.rig.session.recorded_session import Sample, SessionSamples
from palpate.views.exports.json_channels import json_message, json_schema, json_topics
from palpate.views.run_scene import (
    COLOURS,
    LogClock,
    Outline,
    SceneFeed,
    SceneSnapshot,
    TipPosition,
    frame_of,
)

_FRAME = "W"
_M_PER_MM = 1e-3
_TIP_COLOUR = (0.3, 0.75, 0.6)
_TIP_HEIGHT_MM = 20.0
_MIN_ALPHA = 0.25
_DECIMALS = 9


def write_mcap(samples: SessionSamples, path: Path) -> dict[str, int]:
    """Write a session as MCAP; the number of messages on each topic.

    Raises InputError if the file is there already or Foxglove's SDK is missing, OutputError if it cannot be
    written.
    """
    if path.exists():
        raise InputError(f"{path} is there already: choose another name, or remove it")
    channels = FoxgloveChannels(samples.rig, samples.objects, LogClock.of(samples.started))
    try:
        with channels.foxglove.open_mcap(str(path), context=channels.context):
            channels.take_all(samples)
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    return dict(channels.counts)


class FoxgloveChannels:
    """Channels of a run in a context of the SDK, which gives what is logged to its sinks.

    `counts`: messages on each topic.
    """

    def __init__(self, rig: RigFile, objects: Sequence[ObjectModel], clock: LogClock) -> None:
        """Raises MissingPackageError without Foxglove's SDK."""
        self.foxglove = import_extra("foxglove", "export", "Foxglove's formats")
        self._messages = import_extra("foxglove.messages", "export", "Foxglove's formats")
        own = import_extra("foxglove.channels", "export", "Foxglove's formats")
        self.context = self.foxglove.Context()
        self.counts: Counter[str] = Counter()
        self._clock, self._feed = clock, SceneFeed(rig, objects)
        self._channels = {
            "/scene": own.SceneUpdateChannel("/scene", context=self.context),
            "/tf": own.FrameTransformsChannel("/tf", context=self.context),
            "/pose": own.PoseInFrameChannel("/pose", context=self.context),
        }
        for topic, name in json_topics(rig).items():  # before messages, so that nobody misses the first
            self._add_channel(topic, name)
        self._shown: set[str] = set()
        self._part: object = None

    def _add_channel(self, topic: str, name: str) -> None:
        schema = self.foxglove.Schema(
            name=f"palpate.{name}", encoding="jsonschema", data=json.dumps(json_schema(name)).encode()
        )
        self._channels[topic] = self.foxglove.Channel(
            topic, schema=schema, message_encoding="json", context=self.context
        )

    def take_all(self, samples: Iterable[Sample]) -> None:
        """Log samples, and the scene where they change it."""
        for sample in samples:
            self._take(sample)

    def _take(self, sample: Sample) -> None:
        topic, name, values = json_message(sample)
        if topic not in self._channels:
            self._add_channel(topic, name)
        self._log(topic, sample.t_s, json.dumps(values).encode())
        scene = self._feed.take(sample)
        if scene is not None:
            self._log_scene(scene)
            self._log_frames(scene)

    def _log(self, topic: str, t_s: float, message: Any) -> None:
        self._channels[topic].log(message, log_time=self._clock.ns(t_s))
        self.counts[topic] += 1

    def _log_frames(self, scene: SceneSnapshot) -> None:
        """Log where the tips and the parts are."""
        m, stamp = self._messages, self._stamp(scene.t_s)
        places = {f"tip-{tip.finger}": (tip.at_mm, tip.height_mm, 0.0) for tip in scene.tips}
        for item in scene.parts:
            at = item.configuration
            places[frame_of(item)] = (at.x_mm, at.y_mm), 0.0, at.theta_rad
        part = scene.parts[0] if scene.parts else None
        if part is not None and part is not self._part:
            pose = self._pose(*places[frame_of(part)])
            self._log("/pose", scene.t_s, m.PoseInFrame(timestamp=stamp, frame_id=_FRAME, pose=pose))
        self._part = part
        transforms = [
            m.FrameTransform(
                timestamp=stamp,
                parent_frame_id=_FRAME,
                child_frame_id=name,
                translation=self._place(at_mm, height_mm),
                rotation=self._turn(turn_rad),
            )
            for name, (at_mm, height_mm, turn_rad) in places.items()
        ]
        self._log("/tf", scene.t_s, m.FrameTransforms(transforms=transforms))

    def _log_scene(self, scene: SceneSnapshot) -> None:
        m, stamp = self._messages, self._stamp(scene.t_s)
        shapes: dict[str, dict[str, list[Any]]] = {
            item.name: {"lines": [self._line(item)]} for item in scene.outlines
        }
        shapes |= {f"tip-{tip.finger}": self._tip(tip) for tip in scene.tips}
        entities = [
            m.SceneEntity(timestamp=stamp, frame_id=_FRAME, id=name, **shape)
            for name, shape in shapes.items()
        ]
        gone = [
            m.SceneEntityDeletion(timestamp=stamp, type=m.SceneEntityDeletionType.MatchingId, id=name)
            for name in sorted(self._shown - set(shapes))
        ]
        self._shown = set(shapes)
        self._log("/scene", scene.t_s, m.SceneUpdate(deletions=gone, entities=entities))

    def _line(self, item: Outline) -> Any:
        m = self._messages
        kind = m.LinePrimitiveLineType.LineLoop if item.is_closed else m.LinePrimitiveLineType.LineStrip
        z = item.height_mm * _M_PER_MM
        points = [m.Point3(x=x * _M_PER_MM, y=y * _M_PER_MM, z=z) for x, y in item.points_mm.tolist()]
        alpha = max(min(item.weight, 1.0), _MIN_ALPHA)
        return m.LinePrimitive(
            type=kind,
            pose=self._pose((0.0, 0.0), 0.0),
            thickness=2.0,
            scale_invariant=True,
            points=points,
            color=self._colour(COLOURS[item.kind], alpha),
        )

    def _tip(self, tip: TipPosition) -> dict[str, list[Any]]:
        m, across = self._messages, 2 * tip.radius_mm * _M_PER_MM
        cylinder = m.CylinderPrimitive(
            pose=self._pose(tip.at_mm, tip.height_mm),
            size=m.Vector3(x=across, y=across, z=_TIP_HEIGHT_MM * _M_PER_MM),
            bottom_scale=1.0,
            top_scale=1.0,
            color=self._colour(_TIP_COLOUR, 0.8),
        )
        label = m.TextPrimitive(
            pose=self._pose(tip.at_mm, tip.height_mm + _TIP_HEIGHT_MM),
            billboard=True,
            font_size=12.0,
            scale_invariant=True,
            color=self._colour(_TIP_COLOUR, 1.0),
            text=tip.finger,
        )
        return {"cylinders": [cylinder], "texts": [label]}

    def _pose(self, at_mm: tuple[float, float], height_mm: float, turn_rad: float = 0.0) -> Any:
        return self._messages.Pose(position=self._place(at_mm, height_mm), orientation=self._turn(turn_rad))

    def _place(self, at_mm: tuple[float, float], height_mm: float) -> Any:
        return self._messages.Vector3(x=at_mm[0] * _M_PER_MM, y=at_mm[1] * _M_PER_MM, z=height_mm * _M_PER_MM)

    def _turn(self, about_z_rad: float) -> Any:
        half = about_z_rad / 2
        return self._messages.Quaternion(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))

    def _colour(self, rgb: tuple[float, float, float], alpha: float) -> Any:
        return self._messages.Color(r=rgb[0], g=rgb[1], b=rgb[2], a=alpha)

    def _stamp(self, t_s: float) -> Any:
        seconds, rest = divmod(self._clock.ns(t_s), 10**_DECIMALS)
        return self._messages.Timestamp(sec=seconds, nsec=rest)
