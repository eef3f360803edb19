"""Extract a contact from frames of an emulated array: python extract_contact.py

With a recording of your own the rest is the same.
"""

import math

import numpy as np

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile import ContactExtractor, Description, Shape, TactileFrame, TipCalibration

ROWS, COLS, PITCH, RADIUS = 8, 16, math.radians(12), 6.0  # columns 12° apart, mm
array = Description(
    unique_id=b"contacts example",
    firmware="none",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=ROWS,
    cols=COLS,
    bit_depth=12,
    max_rate_hz=200.0,
    full_scale_n=2.0,
    counts_per_n=2000.0,
    tip_radius_mm=RADIUS,
    columns=tuple((col - (COLS - 1) / 2) * PITCH for col in range(COLS)),
    row_heights_mm=tuple(1.0 + 2.0 * row for row in range(ROWS)),
)
taxels = Taxels(array, seed=1, gain_spread=0.1, offset_counts=200, crosstalk=0.075, drift_counts_per_s=0.5)

# A flat face, 0.4 mm into the skin in direction 20°, over the lower five rows: 1.2 N for one second of ten.
angle = np.array(array.columns) - math.radians(20)
dent = np.maximum(0.0, RADIUS - (RADIUS - 0.4) / np.cos(np.clip(angle, -1.2, 1.2)))
load = np.outer(np.arange(ROWS) < 5, 1.2 / 5 * dent / dent.sum())
time_s = np.arange(1000) / 100.0
touched = (time_s >= 6) & (time_s < 7)
counts = taxels.counts(touched.astype(float)[:, None, None] * load, time_s)

tip = TipCalibration(gain=np.ones((ROWS, COLS)), gain_spread=0.1, noise_counts=2.0, drift_counts_per_s=0.5)
extractor = ContactExtractor(array, tip)
extractor.tare([TactileFrame(i, float(time_s[i]), 0.0, counts[i]) for i in range(50)])  # nothing touches yet
patches = extractor.process(counts[50:], time_s[50:])

print(f"touched in {patches.touched.sum()} frames of {len(patches)}")
patch = patches.patch(600)
assert patch is not None, "it is touched then"
print(f"direction {math.degrees(patch.angle_rad):.1f} ± {math.degrees(patch.angle_half_range_rad):.1f}°")
print(f"height {patch.height_mm:.1f} ± {patch.height_bound_mm:.1f} mm")
print(f"force {patch.force_n:.2f} ± {patch.force_bound_n:.2f} N")
print("flags", sorted(flag.name for flag in patch.flags))
