"""A rig file together with the calibration that lies beside it.

Two descriptions of one rig: hand and recogniser use the calibrated one; emulated devices are built from the
one in the rig file, which says round what their hidden truth is drawn.
"""

from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path

from palpate.config import (
    CalibrationFile,
    RigFile,
    apply_calibration,
    calibration_path,
    check_calibration,
    load_calibration,
    load_rig,
    shipped_rig,
)


@dataclass(frozen=True, eq=False)
class RigOnBench:
    """A rig: with its calibration laid over it, and as its file `path` describes it.

    Both are the same if `calibration` is None.
    """

    rig: RigFile
    described: RigFile
    calibration: CalibrationFile | None
    path: Path | Traversable

    @property
    def calibration_path(self) -> Path | None:
        """Path that the calibration was read from; None without one."""
        if self.calibration is None or not isinstance(self.path, Path):
            return None
        return calibration_path(self.path)


def load_calibrated(path: Path | None, *, calibration: bool = True) -> RigOnBench:
    """Read a rig file, or the shipped one, and the calibration beside it, if there is one.

    `calibration`: False to leave it alone. The shipped rig has none. Raises InputError if a file is wrong, or
    the calibration is not of this rig as it is now.
    """
    if path is None:
        rig = load_rig(shipped_rig())
        return RigOnBench(rig, rig, None, shipped_rig())
    described = load_rig(path)
    beside = calibration_path(path)
    if not calibration or not beside.exists():
        return RigOnBench(described, described, None, path)
    found = load_calibration(beside)
    check_calibration(found, described, str(beside), str(path))
    return RigOnBench(apply_calibration(described, found), described, found, path)
