"""The run record of a calibration as a file, between the runs of `palpate calibrate`."""

from pathlib import Path

from pydantic import ValidationError

from palpate.calibration.run_record import RunRecord
from palpate.errors import InputError
from palpate.rig.files import write_text

__all__ = ["FileKeeper"]


class FileKeeper:
    """Keeps the run record in a file that is always whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> RunRecord | None:
        """What is there; InputError if it cannot be read."""
        if not self._path.exists():
            return None
        try:
            return RunRecord.model_validate_json(self._path.read_bytes())
        except (OSError, ValidationError) as error:
            what = str(error).splitlines()[0]
            raise InputError(
                f"{self._path}: the calibration that was begun cannot be taken up ({what}); "
                "add --restart to begin anew"
            ) from None

    def save(self, record: RunRecord) -> None:
        """Replace what is there."""
        write_text(self._path, record.model_dump_json(indent=1) + "\n")

    def forget(self) -> None:
        """There is nothing to resume any more."""
        self._path.unlink(missing_ok=True)
