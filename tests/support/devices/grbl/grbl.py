"""A machine tool with grbl's own firmware, built for this computer, and a ball probe that touches outlines.

grbl (github.com/gnea/grbl, GPLv3) is not part of this repository: PALPATE_GRBL names a checkout of it.
"""

import ctypes
import math
import os
import pty
import shutil
import subprocess
import threading
import tty
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import shapely

SOURCE = os.environ.get("PALPATE_GRBL")
WHY_NOT = (
    "PALPATE_GRBL names no checkout of github.com/gnea/grbl"
    if not (SOURCE and Path(SOURCE, "grbl", "gcode.c").is_file())
    else None
    if shutil.which("cc")
    else "there is no C compiler"
)
_HERE = Path(__file__).parent
_HEADERS = "avr/io.h", "avr/pgmspace.h", "avr/interrupt.h", "avr/wdt.h", "util/delay.h"
_WRAPPED = "st_prep_buffer", "serial_read", "serial_write"
_REPLACED = "eeprom.c"

# Screws of 5 mm at 4000 steps a turn; 2 m/min at most, which is near the 30 kHz that grbl can step.
SETTINGS = [
    *(f"${number}=800" for number in (100, 101, 102)),
    *(f"${number}=2000" for number in (110, 111, 112)),
    *(f"${number}=200" for number in (120, 121, 122)),
]


def build(folder: Path) -> Path:
    """grbl as a shared library; its own source, but for the EEPROM, with `host.c` around it."""
    source, library = Path(str(SOURCE)) / "grbl", folder / "libgrbl.so"
    for name in _HEADERS:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text('#include "avr_host.h"\n')
    files = [str(path) for path in sorted(source.glob("*.c")) if path.name != _REPLACED]
    wraps = [f"-Wl,--wrap={name}" for name in _WRAPPED]
    flags = [
        "-shared",
        "-fPIC",
        "-O2",
        "-w",
        "-fcommon",
        "-DF_CPU=16000000UL",
        "-D__flash=",
        "-Dmain=grbl_main",
    ]
    places = [f"-I{folder}", f"-I{_HERE}", f"-I{source}"]
    command = ["cc", *flags, *places, *files, str(_HERE / "host.c"), *wraps, "-lm", "-o", str(library)]
    subprocess.run(command, check=True, timeout=120)
    return library


@dataclass
class Machine:
    """The machine: `port` is its serial port; one in a process, because grbl has one state.

    `part` (in machine coordinates, mm), its `top_mm`, and where the ball really is (`error_mm` off) may be
    changed while it stands. `overlap_mm`: the deepest that the ball was in the part in free motion.
    """

    library: Path
    radius_mm: float
    part: shapely.Geometry = field(default_factory=shapely.Polygon)
    top_mm: float = 0.0
    draw_error: Callable[[], tuple[float, float]] = lambda: (0.0, 0.0)
    overlap_mm: float = 0.0
    probes: int = 0

    def __post_init__(self) -> None:
        self._error, self._was_probing = (0.0, 0.0), False
        self._wire, other = pty.openpty()
        tty.setraw(other)
        os.set_blocking(self._wire, False)
        self.port, self._kept_open = os.ttyname(other), other
        self._grbl = ctypes.CDLL(str(self.library))
        self._grbl.host_seconds.restype = ctypes.c_double
        kind = ctypes.CFUNCTYPE(ctypes.c_double, *[ctypes.c_double] * 3, ctypes.c_int)
        self._gap = kind(self._gap_mm)
        run = self._grbl.host_run
        self._thread = threading.Thread(target=run, args=(self._wire, self._gap), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Switch it off."""
        self._grbl.host_stop()
        self._thread.join(timeout=60)
        os.close(self._kept_open)
        os.close(self._wire)

    @property
    def seconds(self) -> float:
        """Time by the machine's own clock, while it was moving or waiting by order."""
        return float(self._grbl.host_seconds())

    def _gap_mm(self, x: float, y: float, z: float, probing: int) -> float:
        """Distance from the ball, centred in x, y, z, to the part, which stands upright up to its top."""
        if probing and not self._was_probing:
            self._error, self.probes = self.draw_error(), self.probes + 1
        self._was_probing = bool(probing)
        beside = shapely.distance(self.part, shapely.Point(x + self._error[0], y + self._error[1]))
        gap = math.hypot(beside, max(z - self.top_mm, 0.0)) - self.radius_mm
        if not probing:
            self.overlap_mm = max(self.overlap_mm, -gap)
        return gap if math.isfinite(gap) else 1e3
