"""Work for a process that says that it has begun, and then takes long."""

import os
import sys
import time
from pathlib import Path

__all__ = ["wait"]


def wait(folder: str, seconds: float) -> None:
    """Leave a file of the process's number in a folder, and take so long."""
    Path(folder, str(os.getpid())).touch()
    time.sleep(seconds)


if __name__ == "__main__":
    from palpate.rig.catalogue.processes import in_processes

    place = sys.argv[1]
    list(in_processes(wait, [(place, 600.0), (place, 0.0), (place, 600.0)], workers=3))
