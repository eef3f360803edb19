"""Emulated bench with these arrays on all fingers: a rig file of it, its check, and a part identified."""

from pathlib import Path

import palpate
from palpate.testing import rig_with_arrays

file = rig_with_arrays(Path(), "lines", {"counts_per_n": 2000.0, "oversampling": 4}, rate_hz=50.0)
rig = palpate.open_rig(file, seed=7)
print(rig.check())
print(rig.identify())
