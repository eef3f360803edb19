"""MCAP export of a session: Foxglove's SceneUpdate for drawings, JSON channels for the rest.

Written by Foxglove's SDK, with its schemas, so that viewers show a run without any setting. Shapes are in m,
as viewers want them; the JSON channels keep the log's units, which their keys name. Log time is the start of
the run (UTC) and the rig's clock.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError, OutputError
from palpate.base.geometry import ObjectModel
from palpate.base.optional_imports import import_extra
from palpate.config import RigFile
from palpate.rig.session.recorded_session import EventSample, FrameSample, Sample, SessionSamples, TipSample
from palpate.views.run_scene import COLOURS, LogClock, Outline, SceneSnapshot, TipPosition, scene_changes

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
    try:
        return _Writer(path, LogClock.of(samples.started), samples.rig, samples.objects).write(samples)
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


class _Writer:
    def __init__(self, path: Path, clock: LogClock, rig: RigFile, objects: Sequence[ObjectModel]) -> None:
        self._foxglove = import_extra("foxglove", "export", "writing MCAP files")
        self._messages = import_extra("foxglove.messages", "export", "writing MCAP files")
        self._channels = import_extra("foxglove.channels", "export", "writing MCAP files")
        self._path, self._clock, self._rig, self._objects = path, clock, rig, objects
        self._counts: Counter[str] = Counter()
        self._json: dict[str, Any] = {}
        self._shown: set[str] = set()

    def write(self, samples: Iterable[Sample]) -> dict[str, int]:
        self._context = self._foxglove.Context()
        with self._foxglove.open_mcap(str(self._path), context=self._context):
            self._scenes = self._channels.SceneUpdateChannel("/scene", context=self._context)
            seen: list[Sample] = []
            for sample in samples:
                self._log(sample)
                if isinstance(sample, TipSample | EventSample):
                    seen.append(sample)
            for scene in scene_changes(seen, self._rig, self._objects):
                self._log_scene(scene)
        return dict(self._counts)

    def _log(self, sample: Sample) -> None:
        match sample:
            case FrameSample():
                frame = sample.frame
                rows, columns = frame.counts.shape
                values = {
                    "t_s": sample.t_s,
                    "sequence": frame.sequence,
                    "device_time_s": frame.device_time_s,
                    "rows": rows,
                    "columns": columns,
                    "counts": frame.counts.ravel().tolist(),
                }
                self._log_json(f"/arrays/{sample.finger}", sample.t_s, values)
            case TipSample():
                values = {"t_s": sample.t_s, "x_mm": sample.x_mm, "y_mm": sample.y_mm}
                self._log_json(f"/tips/{sample.finger}", sample.t_s, values)
            case EventSample():
                topic = {"touches": "/contacts", "recognised": "/verdicts"}.get(sample.kind, "/events")
                values = {"t_s": sample.t_s, "event": sample.kind} | dict(sample.values)
                self._log_json(topic, sample.t_s, values)
            case _:
                values = {name: getattr(sample, name) for name in sample.__slots__}
                self._log_json(f"/servos/{sample.joint}", sample.t_s, values)

    def _log_json(self, topic: str, t_s: float, values: Mapping[str, object]) -> None:
        if topic not in self._json:
            self._json[topic] = self._foxglove.Channel(topic, message_encoding="json", context=self._context)
        self._json[topic].log(json.dumps(values).encode(), log_time=self._clock.ns(t_s))
        self._counts[topic] += 1

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
        self._scenes.log(m.SceneUpdate(deletions=gone, entities=entities), log_time=self._clock.ns(scene.t_s))
        self._counts["/scene"] += 1

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

    def _pose(self, at_mm: tuple[float, float], height_mm: float) -> Any:
        m = self._messages
        place = m.Vector3(x=at_mm[0] * _M_PER_MM, y=at_mm[1] * _M_PER_MM, z=height_mm * _M_PER_MM)
        return m.Pose(position=place, orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))

    def _colour(self, rgb: tuple[float, float, float], alpha: float) -> Any:
        return self._messages.Color(r=rgb[0], g=rgb[1], b=rgb[2], a=alpha)

    def _stamp(self, t_s: float) -> Any:
        seconds, rest = divmod(self._clock.ns(t_s), 10**_DECIMALS)
        return self._messages.Timestamp(sec=seconds, nsec=rest)
