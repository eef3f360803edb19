"""Feed of the live view: a session's log, read as it is written, as frames."""

from collections.abc import Mapping
from pathlib import Path

from palpate.base.errors import InputError
from palpate.config import RigFile, load_objects
from palpate.drivers.transport.recording import SessionEvent
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.session.log_file import check_session
from palpate.rig.session.log_tail import LogTail
from palpate.rig.session.samples import EventSample, SampleDecoder
from palpate.views.live.frames import FrameStore, setting_of

__all__ = ["SessionFeed"]


class SessionFeed:
    """Brings a frame store up to date with a session, as far as it is recorded."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError for a folder without a log, or without the rig file of its run."""
        self.store = FrameStore()
        self._folder = folder
        self._tail = LogTail(folder)
        self._decoder: SampleDecoder | None = None
        check_session(folder)
        path = folder / "objects.json"
        objects = load_objects(path).objects if path.exists() else ()
        self.setting: Mapping[str, object] = setting_of(self._rig(calibration=False), objects)

    def update(self) -> None:
        """Take what was written since. A log that cannot be read any further ends the frames and says why."""
        if self.store.is_ended:
            return
        was_written = self._tail.is_written
        try:
            for entry in self._tail.read():
                what = entry.what
                if isinstance(what, SessionEvent) and what.kind == "session":
                    self._decoder = SampleDecoder(
                        self._rig(calibration=what.values.get("calibration") is True)
                    )
                    self.store.take([EventSample(0.0, what.kind, what.values)])
                elif self._decoder is not None:
                    self.store.take(self._decoder.feed(entry))
        except InputError as error:
            self.store.take([EventSample(0.0, "end", {"how": "unreadable", "message": str(error)})])
        if not was_written:  # what was written before it was given up has been read
            self.store.is_ended = True

    def _rig(self, *, calibration: bool) -> RigFile:
        return load_calibrated(self._folder / "rig.toml", calibration=calibration).rig
