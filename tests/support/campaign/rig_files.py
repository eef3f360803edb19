"""Rig files drawn over the whole schema, and what becomes of each: refused in one line, or run to an end."""

import copy
import json
import math
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import PurePosixPath
from typing import Any
from unittest import mock

from hypothesis import strategies as st

from palpate.base.errors import InputError, PalpateError
from palpate.config import ObjectsFile, RigOnBench, load_rig
from palpate.config.loading import SHIPPED_RIGS, Content, Source, shipped_rig
from palpate.config.rig_servos import BUILT_IN_MODELS
from palpate.config.rig_tables import BUS_BAUDRATES
from palpate.drivers.transport import VirtualClock
from palpate.jobs.rig import Rig
from support.benches.rigs import small_objects
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Files. Most values are near those of a bench; of each file some share is anything that is legal.

Table = dict[str, Any]
Draw = Callable[[st.SearchStrategy[Any]], Any]


@dataclass(frozen=True)
class _Drawn:
    """Draws values of keys; `wild`: one in so many is any legal one; 0: none is."""

    draw: Draw
    wild: int
    models: tuple[str, ...]

    def is_wild(self) -> bool:
        return self.wild > 0 and self.flag(self.wild)

    def number(self, lo: float, hi: float, least: float = 1e-6, most: float = 1e6) -> float:
        """From lo to hi; a wild one from `least` to `most`, evenly over decades if both are above 0."""
        if not self.is_wild():
            return float(self.draw(st.floats(min(lo, hi), max(lo, hi))))
        if least > 0:
            return float(10 ** self.draw(st.floats(math.log10(least), math.log10(most))))
        return float(self.draw(st.sampled_from([least, most]) | st.floats(least, most)))

    def length(self, hi: float, most: float = 1e6) -> float:
        """From 0 to hi, often 0."""
        return self.number(0.0, self.draw(st.sampled_from([0.0, hi])), 0.0, most)

    def flag(self, one_in: int = 2) -> bool:
        return self.draw(st.integers(0, 999_999)) % one_in == one_in // 2  # what is simple is no flag

    def of(self, *values: Any) -> Any:
        return self.draw(st.sampled_from(values))

    def optional(self, table: Table, one_in: int, **values: Callable[[], Any]) -> None:
        """Put some keys into a table, each in one of so many files."""
        for key, value in values.items():
            if self.flag(one_in):
                table[key] = value()

    def span(self, hi: float) -> list[float]:
        lo = self.number(0.0, hi / 2, 0.0, hi)
        return [lo, lo + self.number(hi / 100, hi / 2)]


@st.composite
def rig_files(draw: Draw) -> Table:
    """A rig file as a table, with real values for most keys; it may not be legal as a whole."""
    models = draw(st.sampled_from([*((name,) for name in BUILT_IN_MODELS), BUILT_IN_MODELS]))
    d = _Drawn(draw, draw(st.sampled_from([0, 0, 200, 60, 15])), models)
    radius_mm = d.number(25.0, 130.0, 1.0, 1e4)
    count = draw(st.integers(1, 4))
    kinds = d.of(("slide",), ("slide",), ("two-link",), ("slide", "two-link"))
    shapes = d.of(("cylinder",), ("cylinder",), ("ball",), ("pad",), ("cylinder", "ball", "pad"))
    turned = d.number(0, 360, 0.0, 360.0)
    fingers = [
        _finger(d, index, d.of(*kinds), shapes, radius_mm, turned + 360 * index / count)
        for index in range(count)
    ]
    speed = d.number(5.0, 60.0, 1e-3, 1000.0)
    closing = {
        "approach_speed_mm_s": speed,
        "touch_speed_mm_s": speed * d.number(0.02, 0.5, 1e-4, 1.0),
        "back_off_mm": d.number(0.5, 5.0),
        "contact_force_n": d.number(0.05, 0.6, 1e-3, 100.0),
        "max_force_n": d.number(4.0, 15.0, 0.01, 200.0),
        "clearance_mm": d.number(0.0, 6.0, 0.0, 100.0),
        "sample_rate_hz": d.of(60.0, 125.0, 250.0) if not d.is_wild() else d.number(1, 1000, 1.0, 1e4),
    }
    d.optional(closing, 3, search_speed_mm_s=lambda: speed * d.number(0.1, 1.0, 1e-4, 1.0))
    bus = {"port": "mock://bus", "baudrate_bps": d.of(*BUS_BAUDRATES[1:])}
    d.optional(bus, 8, latency_ms=lambda: d.number(1, 40, 1e-3, 1000.0))
    table = {
        "format": "palpate/rig@1",
        "name": "drawn",
        "bus": bus,
        "workspace": {"radius_mm": radius_mm},
        "closing": closing,
        "search": _search(d),
        "fingers": fingers,
        "emulation": _emulation(d, fingers, radius_mm),
    }
    d.optional(table, 8, stage=lambda: _stage(d), obstacles=lambda: [_obstacle(d, radius_mm)])
    return table


def _search(d: _Drawn) -> Table:
    found: Table = {
        "max_grips": d.draw(st.integers(1, 3)),
        "goal_position_mm": d.number(0.3, 3.0),
        "goal_orientation_deg": d.number(0.3, 5.0, 1e-6, 180.0),
    }
    d.optional(
        found,
        4,
        part_holds_n=lambda: d.number(0.1, 2.0, 1e-3, 1e3),
        part_support_mm=lambda: d.number(5, 20),
        false_match_probability=lambda: d.number(0.001, 0.1, 1e-9, 1.0),
        detectable_shift_mm=lambda: d.number(2.0, 20.0),
        budget=lambda: d.draw(st.integers(100_000, 1_000_000)),
    )
    d.optional(found, 10, check_slips=lambda: True)
    return found


def _obstacle(d: _Drawn, radius_mm: float) -> Table:
    angle, size = d.draw(st.floats(0, 6.3)), d.number(2.0, 20.0)
    x, y = (d.number(1.2, 3.0) * radius_mm * turn for turn in (math.cos(angle), math.sin(angle)))
    return {"name": "post", "outline_mm": [[x, y], [x + size, y], [x + size, y + size], [x, y + size]]}


def _stage(d: _Drawn) -> Table:
    turn, ratio = d.number(5.0, 35.0, 0.1, 180.0), d.of(1.0, 3.0, 5.0, -5.0)
    return {
        "centre_mm": [d.number(-3, 3, -50.0, 50.0), d.number(-3, 3, -50.0, 50.0)],
        "dxl_id": 1,
        "model": d.of(*d.models),
        "gear_ratio": ratio,
        "range_deg": [-turn, turn],
        "backlash_deg": d.length(0.05),
        "zero_deg": 180.0,
        "bound_deg": d.length(0.05, 45.0),
        "centre_bound_mm": d.length(0.1),
    }


def _tip(d: _Drawn, shape: str, height_mm: float) -> Table:
    tip: Table = {
        "shape": shape,
        "stiffness_n_per_mm": d.number(1.0, 8.0, 1e-3, 1e4),
        "stiffness_spread": d.length(0.3, 0.99),
    }
    d.optional(tip, 4, bears_n=lambda: d.number(40, 200))
    if shape == "pad":
        return tip | {"width_mm": d.number(4.0, 20.0, 0.2, 200.0), "radius_bound_mm": d.length(0.05)}
    tip |= {"radius_mm": d.number(2.0, 8.0, 0.1, 100.0), "radius_bound_mm": d.length(0.05)}
    d.optional(tip, 2, max_friction=lambda: d.number(0.0, 0.8, 0.0, 2.0))
    if shape == "ball":
        d.optional(tip, 3, max_latitude_deg=lambda: d.number(10, 60, 0.0, 60.0))
    else:
        d.optional(tip, 4, length_mm=lambda: d.number(1, 2 * height_mm))
    return tip


def _finger(
    d: _Drawn, index: int, kind: str, shapes: tuple[str, ...], radius_mm: float, angle_deg: float
) -> Table:
    shape = d.of(*shapes)
    if shape == "pad" and kind == "two-link" and not d.flag(10):  # is refused
        shape = "ball"
    height_mm = d.number(8.0, 14.0, 0.1, 40.0)
    tip = _tip(d, shape, height_mm)
    half_mm = tip.get("radius_mm") or tip["width_mm"] / 2
    array = {
        "port": f"mock://f{index}",
        "baudrate_bps": d.of(115200, 1000000, 2000000),
        "protocol": "palpate",
        "gain_spread": d.length(0.3, 0.99),
        "drift_counts_per_s": d.length(1.0),
    }
    if shape == "pad":
        array["pitch_mm"] = d.number(0.5, 3.0)
    else:
        array |= {"heading_deg": d.number(-20, 20, -360, 360), "heading_bound_deg": d.length(1.0, 45.0)}
        array["coverage_deg"] = d.number(200, 360, 1.0, 360.0)
    bounds = {"base_mm": d.length(0.2), "heading_deg": d.length(0.1, 45.0)}
    d.optional(
        bounds, 6, position_mm=lambda: d.number(0.1, 0.6), deflection_mm_per_n=lambda: d.number(0, 0.05, 0, 1)
    )
    if shape != "pad":
        d.optional(bounds, 6, direction_deg=lambda: d.number(0.1, 2, 1e-3, 45.0))
    d.optional(bounds, 6, deflection_deg_per_n=lambda: d.number(0, 0.1, 0, 10))
    made: Table = {
        "name": f"f{index}",
        "type": kind,
        "height_mm": height_mm,
        "tip": tip,
        "array": array,
        "bounds": bounds,
    }
    place = _slide if kind == "slide" else _arm
    return made | place(d, 10 * index + 11, radius_mm, half_mm, angle_deg)


def _base(away_mm: float, angle_deg: float) -> list[float]:
    return [away_mm * math.cos(math.radians(angle_deg)), away_mm * math.sin(math.radians(angle_deg))]


def _slide(d: _Drawn, dxl_id: int, radius_mm: float, half_mm: float, angle_deg: float) -> Table:
    lo_mm = d.number(20.0, 60.0, 0.0, 1e4)
    away_mm = radius_mm + half_mm + lo_mm + d.number(0.5, 10.0)
    hi_mm = lo_mm + radius_mm * d.number(1.0, 2.0)
    per_turn_mm = d.of(1, 1, 1, -1) * d.number(20.0, 300.0, 0.5, 1000.0)
    at_turn = d.number(0.02, 0.9, 0.0, 0.999)
    ratio, swing_deg = d.of(1.0, 3.0, 5.0, -2.0), d.number(10.0, 40.0, 0.1, 180.0)
    slide = {
        "dxl_id": dxl_id + 1,
        "model": d.of(*d.models),
        "mm_per_turn": per_turn_mm,
        "range_mm": [lo_mm, hi_mm],
        "backlash_mm": d.length(0.1),
        "zero_mm": lo_mm - per_turn_mm * at_turn,
        "zero_bound_mm": d.length(0.1),
        "mm_per_turn_spread": d.length(0.002, 0.99),
        "friction_a": d.length(0.05, 1.0),
    }
    back_mm = lo_mm - min(per_turn_mm * at_turn * 0.9, 8.0) if per_turn_mm > 0 else lo_mm - 3.0
    d.optional(slide, 4, stops_mm=lambda: [max(back_mm, 0.0), hi_mm + d.number(1.0, 10.0)])
    aim = {
        "dxl_id": dxl_id,
        "model": d.of(*d.models),
        "gear_ratio": ratio,
        "range_deg": [-swing_deg, swing_deg],
        "backlash_deg": d.length(0.05),
        "zero_deg": 180.0,
    }
    d.optional(aim, 6, backlash_holds_n=lambda: d.length(2.0))
    heading = (angle_deg + 180 + d.number(-8, 8, -90, 90)) % 360
    return {"base_mm": _base(away_mm, angle_deg), "heading_deg": heading, "aim": aim, "slide": slide}


def _arm(d: _Drawn, dxl_id: int, radius_mm: float, half_mm: float, angle_deg: float) -> Table:
    waits_mm = radius_mm + half_mm + 2.0
    away_mm = waits_mm + d.number(60.0, 140.0, 1.0, 1e4)
    upper_mm = away_mm * d.number(0.55, 0.75)
    fore_mm = upper_mm * d.number(0.8, 1.1)
    bend = ((away_mm - waits_mm) ** 2 - upper_mm**2 - fore_mm**2) / (2 * upper_mm * fore_mm)
    elbow = math.degrees(math.acos(min(max(bend, -1.0), 1.0)))
    side, ratio = d.of(1, -1), d.of(1.0, 2.0)
    across = math.atan2(
        fore_mm * math.sin(math.radians(elbow)), upper_mm + fore_mm * math.cos(math.radians(elbow))
    )
    heading = angle_deg + 180 - side * math.degrees(across) + d.number(-20, 20)
    elbows = sorted(side * end for end in (d.number(10, 30, 0.1, 90.0), min(elbow + 3, 179.0)))
    shoulder = d.number(60, 85, 0.1, 179.0)

    def joint(number: int, lo: float, hi: float) -> Table:
        table = {
            "dxl_id": number,
            "model": d.of(*d.models),
            "gear_ratio": ratio,
            "range_deg": [lo, hi],
            "backlash_deg": d.length(0.05),
            "zero_deg": 180.0 - ratio * (lo + hi) / 2,
            "zero_bound_deg": d.length(0.05, 45.0),
        }
        d.optional(table, 6, backlash_holds_n=lambda: d.length(2.0))
        return table

    return {
        "base_mm": _base(away_mm, angle_deg),
        "heading_deg": math.remainder(heading, 360.0),
        "shoulder": joint(dxl_id, -shoulder, shoulder),
        "elbow": joint(dxl_id + 1, *elbows),
        "links": {
            "upper_mm": upper_mm,
            "fore_mm": fore_mm,
            "bound_mm": d.length(0.1),
            "width_mm": d.number(8, 20),
            "links_height_mm": d.number(30.0, 60.0),
        },
    }


_WITHIN = {
    "gain_spread": "array.gain_spread",
    "drift_counts_per_s": "array.drift_counts_per_s",
    "array_heading_error_deg": "array.heading_bound_deg",
    "stiffness_spread": "tip.stiffness_spread",
    "tip_radius_error_mm": "tip.radius_bound_mm",
    "base_error_mm": "bounds.base_mm",
    "heading_error_deg": "bounds.heading_deg",
    "backlash_mm": "slide.backlash_mm",
    "aim_backlash_deg": "aim.backlash_deg",
    "zero_error_mm": "slide.zero_bound_mm",
    "mm_per_turn_error": "slide.mm_per_turn_spread",
}


def _emulation(d: _Drawn, fingers: list[Table], radius_mm: float) -> Table:
    found: Table = {
        "placement_radius_mm": radius_mm * d.number(0.05, 0.3, 1e-3, 0.99),
        "noise_counts": d.length(3.0),
        "offset_counts": d.length(30.0),
        "crosstalk": d.length(0.1, 0.25),
    }
    for key, place in _WITHIN.items():
        of, name = place.split(".")
        bounds = [finger[of].get(name, 0.0) for finger in fingers if of in finger]
        if bounds:
            found[key] = min(bounds) * d.of(0.0, 0.5, 1.0)
    d.optional(found, 40, dead_taxels=lambda: d.draw(st.integers(0, 3)), start=lambda: "anywhere")
    d.optional(
        found, 10, flipped_bytes=lambda: d.number(0, 1e-4, 0.0, 0.5), array_boot_s=lambda: d.length(2, 10)
    )
    d.optional(
        found, 10, lost_packets=lambda: d.number(0, 1e-3, 0.0, 0.5), array_reset_s=lambda: d.span(10.0)
    )
    d.optional(found, 10, bus_adapter=lambda: _adapter(d), array_adapter=lambda: _adapter(d))
    d.optional(found, 6, mechanics=lambda: _mechanics(d))
    d.optional(
        found,
        3,
        part=lambda: {
            "engine": d.of("still", "quasi-static"),
            "mass_kg": d.number(0.05, 1.0, 1e-3, 100.0),
            "friction": d.number(0.1, 0.6, 1e-3, 2.0),
            "tip_friction": min(finger["tip"].get("max_friction", 0.0) for finger in fingers),
        },
    )
    return found


def _adapter(d: _Drawn) -> Table:
    found: Table = {"latency_ms": d.number(1.0, 16.0, 1.0, 255.0), "echoes": d.flag(8)}
    d.optional(found, 4, stall_ms=lambda: d.span(60.0), gone_after_s=lambda: d.span(20.0))
    d.optional(found, 4, comes_back_as=lambda: "other", grabbed_s=lambda: d.length(1.0))
    return found


def _mechanics(d: _Drawn) -> Table:
    found: Table = {}
    d.optional(
        found,
        3,
        friction=lambda: d.span(2.0),
        rest_friction=lambda: d.span(2.0),
        cogging=lambda: d.span(0.5),
        torque_loss=lambda: [0.0, d.number(0.01, 0.3, 0.01, 0.9)],
        supply_ohm=lambda: d.span(0.5),
        cable_n=lambda: [-d.number(0.1, 1.0), d.number(0.1, 1.0)],
    )
    d.optional(found, 10, slip_mm=lambda: [0.1, d.number(0.2, 3.0)], slip_after_s=lambda: d.span(10.0))
    return found


# ----------------------------------------------------------------------------------------------------
# Files with one key changed.


def leaves(table: Any, *at: Any) -> list[tuple[Any, ...]]:
    """Places of all numbers in a table."""
    if isinstance(table, dict | list):
        items = table.items() if isinstance(table, dict) else enumerate(table)
        return [place for key, value in items for place in leaves(value, *at, key)]
    return [at] if isinstance(table, int | float) and not isinstance(table, bool) else []


@st.composite
def changed_files(draw: Draw, sources: tuple[Source, ...]) -> Table:
    """One of some rig files with a number changed."""
    table = copy.deepcopy(_table(draw(st.sampled_from(sources))))
    *places, key = draw(st.sampled_from(leaves(table)))
    owner = table
    for place in places:
        owner = owner[place]
    old = owner[key]
    scale = draw(st.sampled_from([0, 1e-6, 0.001, 0.01, 0.1, 0.5, 0.9, 1.1, 2, 5, 10, 100, 1e4, -1]))
    owner[key] = type(old)(old * scale + draw(st.sampled_from([0, 0, 0.1, 1])))
    table["search"]["max_grips"] = min(table["search"]["max_grips"], 2)
    return table


def shipped_files() -> tuple[Source, ...]:
    """Emulated rigs that are shipped."""
    names = ("firm-rig", "pad-rig", "ball-rig", "two-link-rig")
    return (*(EXAMPLES / f"{name}.toml" for name in names), *map(shipped_rig, SHIPPED_RIGS))


@cache
def _table(source: Source) -> Table:
    return tomllib.loads(source.read_text())  # type: ignore[union-attr]


# ----------------------------------------------------------------------------------------------------
# What becomes of a file.

MAX_RIG_S = 20.0


class Longer(Exception):  # not an error: a run that goes on
    """More of the rig's time than a campaign waits for."""


@dataclass(frozen=True)
class Fate:
    """`kind`: "refused", "refused after check", "problems", "ended", "stopped", "longer"; `text`: why."""

    kind: str
    text: str


def fate(table: Table, seed: int = 0, objects: ObjectsFile | None = None) -> Fate:
    """Load, check and run it in virtual time; raises what is no error of palpate's."""
    try:
        rig = load_rig(Content("drawn.toml", toml(table).encode()))
    except InputError as error:
        return Fate("refused", _one_line(str(error)))
    on_bench = RigOnBench(rig, rig, None, _NoPath("drawn.toml"))
    sleep = VirtualClock.sleep

    def count(clock: VirtualClock, seconds: float) -> None:
        sleep(clock, seconds)
        if clock.now() > MAX_RIG_S:
            raise Longer

    with mock.patch.object(VirtualClock, "sleep", count), suppress(Longer):
        return _run(Rig(on_bench, None, seed), objects or _one_part())
    return Fate("longer", f"more than {MAX_RIG_S:g} s of the rig's time")


def _run(rig: Rig, objects: ObjectsFile) -> Fate:
    try:
        checked = rig.check()
        if not checked.well:
            return Fate("problems", _one_line(next(iter(checked.problems), "")))
    except PalpateError as error:
        return Fate("refused", _one_line(str(error)))
    silent: Table = dict.fromkeys(("notice", "warn", "progress"), lambda _: None)
    try:
        answer = rig.identify(objects, **silent)
    except InputError as error:
        return Fate("refused after check", _one_line(str(error)))
    except PalpateError as error:
        return Fate("stopped", f"{type(error).__name__}: {_one_line(str(error))}")
    return Fate("ended", str(answer.verdict))


def _one_line(text: str) -> str:
    assert text, "an error without words"
    assert "\n" not in text, text
    return text


@cache
def _one_part() -> ObjectsFile:
    objects = small_objects()
    return replace(objects, objects=objects.objects[:1])


class _NoPath(PurePosixPath):
    """Path of a rig file that is not there, with no calibration beside it."""

    def read_bytes(self) -> bytes:
        return b""


def toml(table: Table) -> str:
    """A rig file's text: tables below the top level are inline."""
    return "".join(f"{key} = {_inline(value)}\n" for key, value in table.items())


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return json.dumps(value)
