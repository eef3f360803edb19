"""Feed of the live view: a session's log, read as it is written, as frames."""

from collections.abc import Mapping
from pathlib import Path

from palpate.config import RigFile, load_objects
from palpate.drivers.transport.recording import SessionEvent
from palpate.errors import InputError
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.session.log_tail import LogTail
from palpate.rig.session.samples import EventSample, SampleDecoder
from palpate.views.live.frames import FrameStore, setting_of

__all__ = ["SessionFeed"]


class SessionFeed:
    """Brings a frame store up to date with a session, as far as it is recorded."""

    def __init__(self, folder: Path, *, is_awaited: bool) -> None:
        """`is_awaited`: its log may not be there yet. Raises InputError if it should be and is not."""
        self.store = FrameStore()
        self._folder = folder
        self._tail = LogTail(folder)
        self._decoder: SampleDecoder | None = None
        if not is_awaited and not self._tail.path.is_file():
            raise InputError(f"{folder} is not a session: {self._tail.path} is missing")

    def setting(self) -> Mapping[str, object]:
        """What does not change; raises InputError while the session's rig and objects are not kept yet."""
        rig = load_calibrated(self._folder / "rig.toml", calibration=False).rig
        return setting_of(rig, load_objects(self._folder / "objects.json").objects) | {
            "session": self._folder.name
        }

    def update(self) -> None:
        """Take what was written since."""
        if not (self._folder / "rig.toml").is_file():
            return
        for entry in self._tail.read():
            if self._decoder is None:
                self._decoder = SampleDecoder(self._rig(entry.what))
            if isinstance(entry.what, SessionEvent) and entry.what.kind == "session":
                self.store.take([EventSample(0.0, "session", entry.what.values)])
            else:
                self.store.take(self._decoder.feed(entry))
        if not self._tail.is_written:
            self.store.is_ended = True

    def _rig(self, first: object) -> RigFile:
        calibrated = isinstance(first, SessionEvent) and first.values.get("calibration") is True
        return load_calibrated(self._folder / "rig.toml", calibration=calibrated).rig
