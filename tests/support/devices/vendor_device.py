"""A device on the vendor's own library for Arduino boards, compiled for this computer, on a pseudo-terminal.

The library is on no package index: PALPATE_DYNAMIXEL2ARDUINO names a checkout of ROBOTIS's Dynamixel2Arduino.
"""

import os
import shutil
import subprocess
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from palpate.drivers.dynamixel.control_table import Item

SOURCES = Path(__file__).parent / "arduino"
PARTS = ("utility/slave.cpp", "utility/port_handler.cpp", "dxl_c/protocol.cpp")


def compiled_device(folder: Path) -> Path:
    """The compiled device; skips the test, with the reason, where library or compiler are missing."""
    named = os.environ.get("PALPATE_DYNAMIXEL2ARDUINO")
    if named is None:
        pytest.skip(
            "no device of the vendor's: PALPATE_DYNAMIXEL2ARDUINO names no checkout of Dynamixel2Arduino"
        )
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no device of the vendor's: g++ is not installed")
    library, program = Path(named) / "src", folder / "vendor-device"
    places = [f"-I{place}" for place in (SOURCES, library, library / "utility")]
    words = [compiler, "-O1", *places, str(SOURCES / "main.cpp"), *(str(library / part) for part in PARTS)]
    subprocess.run([*words, "-o", str(program)], check=True)
    return program


@contextmanager
def vendor_device(program: Path, number: int, firmware: int, dxl_id: int, items: list[Item]) -> Iterator[str]:
    """Path of the port on which such a device answers."""
    near, far = os.openpty()
    tty.setraw(far)
    places = [f"{item.address}:{item.size}" for item in items]
    words = [str(program), str(number), str(firmware), str(dxl_id), *places]
    process = subprocess.Popen(words, stdin=near, stdout=near)
    try:
        yield os.ttyname(far)
    finally:
        process.terminate()
        process.wait()
        os.close(near)
        os.close(far)
