"""ROS 2 bag export of a session, by `rosbags`; no ROS is needed. Its topics are those of `ros_messages`."""

from collections import Counter
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError, OutputError
from palpate.base.optional_imports import import_extra
from palpate.rig.session.recorded_session import SessionSamples
from palpate.views.exports.ros_messages import RosMessages
from palpate.views.run_scene import LogClock

_BAG_VERSION = 9


def write_rosbag(samples: SessionSamples, folder: Path) -> dict[str, int]:
    """Write a session as a ROS 2 bag; the number of messages on each topic.

    Raises InputError if the folder is there already or `rosbags` is missing, OutputError if it cannot be
    written.
    """
    if folder.exists():
        raise InputError(f"{folder} is there already: choose another name, or remove it")
    messages = RosMessages(samples.rig, samples.objects, LogClock.of(samples.started), "export")
    store, counts, connections = messages.store, Counter[str](), dict[str, Any]()
    rosbag2 = import_extra("rosbags.rosbag2", "export", "writing ROS 2 bags")
    try:
        with rosbag2.Writer(folder, version=_BAG_VERSION) as bag:
            for sample in samples:
                for topic, t_s, message in messages.of(sample):
                    kind = message.__msgtype__
                    if topic not in connections:
                        connections[topic] = bag.add_connection(topic, kind, typestore=store)
                    data = store.serialize_cdr(message, kind)
                    bag.write(connections[topic], messages.clock.ns(t_s), data)
                    counts[topic] += 1
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror or error}") from error
    return dict(counts)
