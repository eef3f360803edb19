"""A calibration file made up for tests: three fingers, touches round some placings, arrays with faults."""

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np

from palpate.config.calibration_file import CalibrationFile

__all__ = ["calibration_example"]

_BASES = ((0.0, 190.0), (-164.545, -95.0), (164.545, -95.0))
_PLACINGS = ((0.0, 0.0, 20.0), (45.0, 30.0, 15.0), (-50.0, 25.0, 15.0), (5.0, -55.0, 20.0))
_TIP_MM = 5.0


def calibration_example(
    seed: int = 1,
    rows: int = 8,
    cols: int = 20,
    off_mm: float = 0.02,
    names: tuple[str, str, str] = ("f1", "f2", "f3"),
) -> CalibrationFile:
    """What a calibration of a bench might have found; residuals have the deviation `off_mm`."""
    rng = np.random.default_rng(seed)
    touches = [
        _touch(rng, name, base, number, disc, off_mm)
        for name, base in zip(names, _BASES, strict=True)
        for number, disc in enumerate(_PLACINGS)
        for _ in range(6)
    ]
    touches[7] |= {"residual_mm": 0.31, "outlier": True, "held_out": False}
    return CalibrationFile.model_validate(
        {
            "rig": "bench",
            "rig_sha256": "1" * 64,
            "geometry_sha256": "0123456789abcdef" * 4,
            "made": datetime(2026, 3, 14, 15, 9, tzinfo=UTC),
            "palpate": "0.1.0",
            "emulated": True,
            "coverage": 0.999,
            "references": [{"name": "disc-40", "sha256": "2" * 64}, {"name": "disc-30", "sha256": "3" * 64}],
            "devices": [
                {
                    "port": f"mock://f{k}",
                    "kind": "array",
                    "id": f"{k:016x}",
                    "model": "8 x 20",
                    "firmware": "1.4",
                }
                for k in range(len(names))
            ],
            "fingers": [
                _finger(rng, name, base, rows, cols) for name, base in zip(names, _BASES, strict=True)
            ],
            "residuals": {
                "rms_mm": off_mm,
                "largest_mm": 3 * off_mm,
                "touches": 58,
                "degrees_of_freedom": 31,
                "chi_square": 29.5,
                "outliers": 1,
                "held_out": 13,
                "held_out_rms_mm": 1.2 * off_mm,
                "held_out_largest_mm": 2.5 * off_mm,
                "touches_seen": touches,
            },
        }
    )


def _touch(
    rng: np.random.Generator,
    name: str,
    base: tuple[float, float],
    number: int,
    disc: tuple[float, float, float],
    off_mm: float,
) -> dict[str, Any]:
    """A touch of a disc (x, y, radius) from a base's side."""
    x, y, radius = disc
    normal = math.atan2(base[1] - y, base[0] - x) + rng.uniform(-0.9, 0.9)
    reach = radius + _TIP_MM
    return {
        "finger": name,
        "placing": number,
        "x_mm": x + reach * math.cos(normal),
        "y_mm": y + reach * math.sin(normal),
        "normal_deg": math.degrees(normal),
        "residual_mm": float(rng.normal(0, off_mm)),
        "held_out": bool(rng.uniform() < 0.2),
        "outlier": False,
    }


def _finger(
    rng: np.random.Generator, name: str, base: tuple[float, float], rows: int, cols: int
) -> dict[str, Any]:
    gain = rng.uniform(0.82, 1.2, (rows, cols))
    bound = np.full((rows, cols), 0.03)
    gain[:, :3], bound[:, :3] = 1.0, 0.2  # never pressed
    unusable = [{"row": 2, "col": 9, "what": "dead"}, {"row": rows - 1, "col": 5, "what": "hot"}]
    return {
        "name": name,
        "tactile": {
            "gain": gain.tolist(),
            "gain_bound": bound.tolist(),
            "unusable": unusable,
            "noise_counts": 2.03,
            "offset_counts": 20.4,
            "drift_counts_per_s": 0.12,
            "crosstalk": 0.061,
            "crosstalk_bound": 0.004,
            "stiffness_n_per_mm": 3.12,
            "stiffness_bound": 0.034,
            "least_contact_force_n": 0.052,
            "phase_deg": 0.8,
            "phase_sigma_deg": 0.11,
            "presses": 24,
            "residual_share": 0.018,
        },
        "actuators": {
            "slide": {
                "direction_confirmed": True,
                "mm_per_turn": 100.02,
                "mm_per_turn_sigma": 0.011,
                "zero_mm": 40.013,
                "zero_sigma_mm": 0.009,
                "homed": True,
                "backlash_mm": 0.081,
                "backlash_sigma_mm": 0.004,
                "touch_zero_mm": 89.98,
                "touch_covariance": [[1e-4, 0.0], [0.0, 1e-8]],
                "friction_a": 0.028,
                "latency_s": 0.0071,
                "latency_bound_s": 0.0124,
                "settle_s": 0.0093,
                "overshoots": [
                    {"speed_mm_s": 10.0, "largest_mm": 0.1, "bound_mm": 0.15},
                    {"speed_mm_s": 20.0, "largest_mm": 0.2, "bound_mm": 0.27},
                ],
            },
            "aim": {
                "direction_confirmed": True,
                "backlash_deg": 0.021,
                "backlash_sigma_deg": 0.003,
                "friction_a": 0.027,
            },
        },
        "place": {
            "base_mm": [base[0] + 0.031, base[1] - 0.022],
            "base_sigma_mm": [0.012, 0.014],
            "heading_deg": 270.013,
            "heading_sigma_deg": 0.006,
            "tip_radius_mm": 5.012,
            "tip_radius_sigma_mm": 0.008,
            "array_heading_deg": 0.84,
            "array_heading_sigma_deg": 0.09,
            "zero_mm": 39.931,
            "mm_per_turn": 100.018,
            "covariance": (np.diag([0.012, 0.014, 1e-4, 0.008, 0.01]) ** 2).tolist(),
        },
        "bounds": {
            "position_mm": 0.128,
            "direction_deg": 0.31,
            "parts_mm": {
                "fit": 0.04,
                "repeatability": 0.03,
                "quantisation": 0.012,
                "play": 0.02,
                "overshoot": 0.026,
            },
            "normal_parts_deg": {"fit": 0.2, "repeatability": 0.06, "quantisation": 0.02, "play": 0.03},
        },
    }
