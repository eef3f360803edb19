"""Builds `firmware/` with the computer's C compiler, once for all tests that run at the same time."""

import fcntl
import subprocess
from pathlib import Path

from repository import ROOT

__all__ = ["FIRMWARE", "build_firmware"]

FIRMWARE = ROOT / "firmware"


def build_firmware(target: str = "all") -> Path:
    """Make a target of `firmware/Makefile`; returns the folder with the programs."""
    built = FIRMWARE / "build"
    built.mkdir(exist_ok=True)
    with (built / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = subprocess.run(
            ["make", "-C", str(FIRMWARE), target], capture_output=True, text=True, timeout=300, check=False
        )
    assert done.returncode == 0, (
        f"the firmware does not build; is there a C compiler?\n{done.stdout}{done.stderr}"
    )
    return built
