"""Emulated rigs for tests: the shipped one with other arrays, and one served by another process."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tomlkit

from palpate.config import shipped_rig

__all__ = ["rig_with_arrays", "served"]

_PALPATE = Path(sys.executable).with_name("palpate")


def rig_with_arrays(folder: Path, protocol: str, keys: Mapping[str, Any], rate_hz: float = 250.0) -> Path:
    """Write the shipped emulated rig with arrays of `protocol` on all fingers; returns the new file.

    `keys`: what each array's table has to say beside the protocol. `rate_hz`: frames a second of an array.
    """
    rig = tomlkit.parse(shipped_rig().read_text(encoding="utf-8")).unwrap()
    rig["closing"]["sample_rate_hz"] = rate_hz
    for finger in rig["fingers"]:
        finger["array"] |= {"protocol": protocol, **keys}
    file = folder / f"{protocol}.toml"
    file.write_text(tomlkit.dumps(rig), encoding="utf-8")
    return file


@contextmanager
def served(folder: Path, *args: object) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Run `palpate emulate` with `args` in `folder`: its process, and the JSON object that it prints.

    With `--pty`, commands in other processes can take the emulated rig for a real one. Ended as by Ctrl-C.
    """
    process = subprocess.Popen(
        [str(_PALPATE), "emulate", *map(str, args)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        printed = json.loads(process.stdout.readline())
        assert isinstance(printed, dict)
        yield process, printed
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        finally:
            process.kill()
