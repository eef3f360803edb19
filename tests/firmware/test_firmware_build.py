"""How the firmware is built, and its ports."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from support.commands.command import PATIENCE_S
from support.devices.firmware import FIRMWARE, build_firmware

# ----------------------------------------------------------------------------------------------------
# What the firmware promises about itself: no allocation, hardly any library, and no byte that breaks it.

CORE = sorted(path for path in FIRMWARE.glob("palpate_*.[ch]"))
ALLOWED_HEADERS = {"stdint.h", "stddef.h", "stdbool.h", "string.h"}
ALLOWED_CALLS = {"memcpy", "memset", "strlen"}


@pytest.mark.parametrize("path", [*CORE, FIRMWARE / "port_template.c"], ids=lambda path: path.name)
def test_the_portable_part_includes_four_headers(path: Path) -> None:
    assert set(re.findall(r"#include <(.+)>", path.read_text(encoding="utf-8"))) <= ALLOWED_HEADERS


def test_the_portable_part_calls_the_port_and_hardly_any_library(built: Path, tmp_path: Path) -> None:
    sources = sorted(map(str, FIRMWARE.glob("palpate_*.c")))
    subprocess.run(
        ["cc", "-std=c99", "-O1", "-fno-stack-protector", "-c", *sources], cwd=tmp_path, check=True
    )
    listed = subprocess.run(
        ["nm", "--undefined-only", "--format=just-symbols", *sorted(map(str, tmp_path.glob("*.o")))],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    called = set(re.findall(r"^\w+$", listed, re.MULTILINE))
    outside = {name for name in called if not name.startswith("palpate_")}
    assert outside <= ALLOWED_CALLS
    assert {"palpate_port_read", "palpate_port_write", "palpate_port_sample"} <= called


@pytest.mark.parametrize("seed", [1, 2])
def test_random_and_mutated_bytes(built: Path, seed: int) -> None:
    """The fuzzer checks what goes out and that a HELLO is heard; sanitizers watch it."""
    ended = subprocess.run(
        [str(built / "fuzz"), str(seed), "200000"],
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    told = json.loads(ended.stdout)
    assert told["bytes_in"] > 5_000_000
    assert all(count > 500 for count in told.values()), "every kind of answer was tried"


def test_the_template_compiles(built: Path) -> None:
    assert (built / "template").is_file()


@pytest.mark.parametrize(
    "size",
    [
        "PALPATE_MAX_TAXELS=0",
        "PALPATE_MAX_TAXELS=4097",
        "PALPATE_RX_BYTES=29",
        "PALPATE_TX_BYTES=300",
        "PALPATE_MAX_PLACES=256",
        "PALPATE_MAX_NAME=256",
    ],
)
def test_sizes_that_cannot_be_do_not_compile(size: str) -> None:
    ended = subprocess.run(
        ["cc", "-std=c99", "-fsyntax-only", f"-D{size}", str(FIRMWARE / "palpate_array.c")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode != 0
    assert "palpate_assert_" in ended.stderr


# ----------------------------------------------------------------------------------------------------
# Ports for boards that people have, as far as Debian has what it takes to compile them.

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
