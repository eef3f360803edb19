"""The run record of a calibration as a file, between the runs of `palpate calibrate`."""

from pathlib import Path

from palpate.base.errors import InputError
from palpate.base.files.writing import write_text
from palpate.calibration.run_record import RunRecord
from palpate.config.loading import load_json

__all__ = ["RunRecordFile"]


class RunRecordFile:
    """Keeps the run record in a file that is always whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> RunRecord | None:
        """What is there; InputError if it cannot be read."""
        if not self._path.exists():
            return None
        try:
            return load_json(self._path, RunRecord, {})
        except InputError as error:
            raise InputError(
                f"{error}: the calibration that was begun cannot be taken up; restart to begin anew"
            ) from None

    def save(self, record: RunRecord) -> None:
        """Replace what is there."""
        write_text(self._path, record.model_dump_json(indent=1) + "\n")

    def forget(self) -> None:
        """There is nothing to resume any more."""
        self._path.unlink(missing_ok=True)
