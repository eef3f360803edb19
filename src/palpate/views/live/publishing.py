"""Publishers of a running session to other programs: Foxglove's websocket, and rosbridge for ROS.

They read the session's log beside the run, in a process of their own, as the page of the live view does: a
client that is slow or gone loses messages, and the run never waits.
"""

import dataclasses
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.optional_imports import import_extra
from palpate.rig.session.recorded_session import EventSample, Sample, started_in
from palpate.views.exports.foxglove import FoxgloveChannels
from palpate.views.exports.ros_messages import RosMessages
from palpate.views.live.frames import SessionTail
from palpate.views.live.server import HOST
from palpate.views.run_scene import LogClock

_PERIOD_S = 0.05
_RETRY_S = 1.0
_PATIENCE_S = 2.0
_LAST_MESSAGES_S = 0.5  # until the server has sent them: the answer is among them

Publisher = Callable[[Sequence[Sample]], None]
"""Takes what was recorded since it was called last."""

PublisherOf = Callable[[SessionTail, LogClock], AbstractContextManager[Publisher]]
"""Opens a publisher of a session, when its run has begun."""


def publish(tail: SessionTail, open_publisher: PublisherOf) -> None:
    """Publish a session while it is recorded, to its last sample. Raises InputError once it is recorded."""
    if not tail.is_written:
        raise InputError("the run has ended: palpate export writes what was recorded")
    samples = list(tail.read())
    while not (samples or tail.is_ended):
        time.sleep(_PERIOD_S)
        samples = list(tail.read())
    header = [sample.values for sample in samples[:1] if isinstance(sample, EventSample)]
    with open_publisher(tail, LogClock.of(started_in(*header))) as take:
        while samples or not tail.is_ended:
            take(samples)
            time.sleep(_PERIOD_S)
            samples = list(tail.read())


def foxglove_publisher(port: int, ready: Callable[[str], None]) -> PublisherOf:
    """Foxglove's websocket on this computer, with the channels of MCAP files; `ready` is told the address."""

    @contextmanager
    def serving(tail: SessionTail, clock: LogClock) -> Iterator[Publisher]:
        channels = FoxgloveChannels(tail.rig, tail.objects, clock)
        name = f"palpate {tail.rig.name}"
        try:
            server: Any = channels.foxglove.start_server(
                name=name, host=HOST, port=port, context=channels.context
            )
        except RuntimeError as error:  # as the SDK says that a port is taken
            raise InputError(f"port {port} cannot be served: {error}; choose another with --port") from None
        ready(f"ws://{HOST}:{server.port}")
        try:
            yield channels.take_all
            time.sleep(_LAST_MESSAGES_S)
        finally:
            server.stop()

    return serving


def rosbridge_publisher(address: str, ready: Callable[[str], None]) -> PublisherOf:
    """Publish to the rosbridge at HOST:PORT, with the topics of ROS 2 bags; `ready` is told when it answers.

    Of joints, tips and arrays it is sent what is newest, 20 times a second.
    """

    @contextmanager
    def publishing(tail: SessionTail, clock: LogClock) -> Iterator[Publisher]:
        messages, bridge = RosMessages(tail.rig, tail.objects, clock, "ros"), _Rosbridge(address, ready)

        def take(samples: Sequence[Sample]) -> None:
            for sample in _newest(samples):
                for topic, _, message in messages.of(sample):
                    bridge.publish(topic, message)

        try:
            yield take
        finally:
            bridge.close()

    return publishing


def _newest(samples: Sequence[Sample]) -> Sequence[Sample]:
    """Events, and the last sample of each joint, tip and array."""
    last: dict[object, int] = {}
    for number, sample in enumerate(samples):
        name = getattr(sample, "joint", None) or getattr(sample, "finger", number)
        last[type(sample), name] = number
    return [samples[number] for number in sorted(last.values())]


class _Rosbridge:
    """Connection to a rosbridge (protocol v2.1); what cannot be sent is lost, and it is tried again later."""

    def __init__(self, address: str, ready: Callable[[str], None]) -> None:
        self._client = import_extra("websockets.sync.client", "ros", "publishing to ROS")
        self._errors = import_extra("websockets.exceptions", "ros", "publishing to ROS")
        self._url, self._ready = f"ws://{address}", ready
        self._connection: Any = None
        self._advertised: set[str] = set()
        self._next_try_s = 0.0

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message, or lose it."""
        if self._connection is None and time.monotonic() < self._next_try_s:
            return
        try:
            self._connect()
            if topic not in self._advertised:
                self._send({"op": "advertise", "topic": topic, "type": message.__msgtype__})
                self._advertised.add(topic)
            self._send({"op": "publish", "topic": topic, "msg": ros_json(message)})
        except (OSError, self._errors.WebSocketException):
            self._connection, self._next_try_s = None, time.monotonic() + _RETRY_S

    def close(self) -> None:
        """End the connection."""
        if self._connection is not None:
            self._connection.close()

    def _connect(self) -> None:
        if self._connection is None:
            patience = dict.fromkeys(
                ("open_timeout", "ping_interval", "ping_timeout", "close_timeout"), _PATIENCE_S
            )
            self._connection = self._client.connect(self._url, compression=None, **patience)
            self._advertised.clear()
            self._ready(self._url)

    def _send(self, values: Mapping[str, object]) -> None:
        self._connection.send(json.dumps(values))


def ros_json(value: Any) -> Any:
    """A message of `rosbags` as rosbridge takes it."""
    if dataclasses.is_dataclass(value):  # constants of its type have defaults
        names = [field.name for field in dataclasses.fields(value) if field.default is dataclasses.MISSING]
        return {name: ros_json(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [ros_json(item) for item in value] if isinstance(value, list) else value
