"""The resistive matrix passes the suite that every array which sends by itself has to pass."""

from pathlib import Path

from palpate.testing import FreeRunningConformance, RigConformance


class TestFsrMatrix(FreeRunningConformance):
    protocol = "fsr-matrix"
    keys = {
        "columns": 7,
        "column_step_deg": 22.918,
        "row_heights_mm": [1.7, 5.1, 8.5, 11.9, 15.3],
        "conductance_per_n": 0.9,
        "rate_hz": 25.0,
    }


class TestBench(RigConformance):
    rig = Path(__file__).parents[1] / "examples" / "fsr-bench.toml"
