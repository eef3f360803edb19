"""Ports for boards that people have, as far as Debian has what it takes to compile them."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from firmware_build import FIRMWARE, build_firmware

ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino")
PORTS = sorted([*FIRMWARE.glob("ports/*/*.c"), *FIRMWARE.glob("ports/*/*/*.ino")])


@pytest.mark.skipif(
    shutil.which("avr-gcc") is None or not ARDUINO.is_dir(),
    reason="needs the Debian packages gcc-avr, avr-libc, arduino-core-avr",
)
def test_the_sketch_fits_an_uno() -> None:
    """2 kB of RAM: half of it stays for the stack."""
    elf = build_firmware("arduino") / "uno" / "firmware.elf"
    listed = subprocess.run(["avr-size", str(elf)], capture_output=True, text=True, check=True)
    code, data, zeroed = map(int, listed.stdout.splitlines()[1].split()[:3])
    assert code + data < 10_000
    assert data + zeroed < 1024


@pytest.mark.parametrize("path", PORTS, ids=lambda path: path.parent.name)
def test_a_port_fills_in_every_function(path: Path) -> None:
    wanted = re.findall(r"palpate_port_\w+(?=\()", (FIRMWARE / "palpate_port.h").read_text(encoding="utf-8"))
    assert len(set(wanted)) == 7
    text = path.read_text(encoding="utf-8")
    for name in wanted:
        assert re.search(rf"^(extern \"C\" )?\w+ {name}\(.*\{{$", text, re.MULTILINE), name
