"""Rigs that are not as their file says, drawn at random: what is true, what is told, and what the sensors do.

A *set-up* is a rig file that is true (the emulated bench is built from it) and one that palpate is told. They
differ by one mistake of the kind that people make on a first day. Faults of a sensor or a servo leave the two
files alike. Nothing here imports what finds such mistakes.
"""

import copy
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from wrong_sensors import SENSORS, File, Lags, Sensor

from palpate.config import RigFile, shipped_rig
from palpate.drivers.dynamixel import Instruction
from palpate.drivers.dynamixel.packet import InstructionPacket, encode_instruction

EXAMPLES = Path(__file__).parents[1] / "examples"


@dataclass(frozen=True)
class SetUp:
    """A rig file that is true, one that is told, and what is wrong with devices.

    `sensors`: by the name of a finger, what its array does. `written`: packets that another program sent to
    the servos' bus before.
    """

    rig: str
    mistake: str
    true: File
    told: File
    sensors: Mapping[str, Callable[[], Sensor]] = field(default_factory=dict)
    written: tuple[bytes, ...] = ()
    detail: str = ""

    @property
    def is_right(self) -> bool:
        """True if nothing is wrong."""
        return self.mistake == "right"


# ----------------------------------------------------------------------------------------------------
# Rigs


def _read(path: Path) -> File:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def _two_fingers() -> File:
    rig = _read(EXAMPLES / "firm-rig.toml")
    return rig | {"name": "two-fingers", "fingers": rig["fingers"][:2]}


def _geared() -> File:
    """Slides of another make, named by side, on a smaller table."""
    rig = _read(EXAMPLES / "firm-rig.toml")
    for finger, name in zip(rig["fingers"], ("right", "left", "far"), strict=True):
        finger["name"] = name
        finger["array"]["port"] = f"mock://{name}"
        finger["aim"] |= {"gear_ratio": 4.0, "zero_deg": 170.0}
        finger["slide"] |= {"mm_per_turn": -94.25, "zero_mm": 100.0}
        finger["tip"]["radius_mm"] = 4.0
    return rig | {"name": "geared"}


UNMEASURED = "fresh"
"""The rig that is there to be calibrated: too little is known of it to identify parts."""


def rigs() -> dict[str, File]:
    """Rig files by name, each true as it stands."""
    benches = shipped_rig().parent
    return {
        "shipped": _read(shipped_rig()),
        "firm": _read(EXAMPLES / "firm-rig.toml"),
        "xl330": _emulated(_read(benches / "xl330-bench.toml")),
        "pads": _read(EXAMPLES / "pad-rig.toml"),
        "arms": _read(EXAMPLES / "two-link-rig.toml"),
        "two": _two_fingers(),
        "geared": _geared(),
        UNMEASURED: _read(EXAMPLES / "fresh-rig.toml"),
    }


def read(name: str) -> File:
    """Return the file of a rig of `rigs`, or of a path."""
    return _emulated(_read(Path(name))) if name.endswith(".toml") else rigs()[name]


def _emulated(rig: File) -> File:
    """A bench's file, whose devices are emulated as the file says already or with its own bounds."""
    if "emulation" not in rig:
        raise ValueError(f"{rig['name']} has no [emulation]")
    return rig


# ----------------------------------------------------------------------------------------------------
# Mistakes in the file: each changes what is told of a rig that is true


def _pick(rig: File, rng: np.random.Generator, count: int = 1) -> list[File]:
    found = rng.permutation(len(rig["fingers"]))[:count]
    return [rig["fingers"][int(index)] for index in found]


def _joints(finger: File) -> tuple[str, str]:
    near, far = (key for key in ("aim", "slide", "shoulder", "elbow") if key in finger)
    return near, far


def _exchange(items: list[tuple[File, str]]) -> None:
    values = [table[key] for table, key in items]
    for (table, key), value in zip(items, values[1:] + values[:1], strict=True):
        table[key] = value


def arrays_exchanged(told: File, rng: np.random.Generator) -> str:
    """Ports of two arrays, or of all."""
    chosen = _pick(told, rng, int(rng.integers(2, len(told["fingers"]) + 1)))
    _exchange([(finger["array"], "port") for finger in chosen])
    return " ".join(finger["name"] for finger in chosen)


def ids_exchanged(told: File, rng: np.random.Generator) -> str:
    """Ids of two fingers, both joints."""
    chosen = _pick(told, rng, 2)
    for joint in _joints(chosen[0]):
        _exchange([(finger[joint], "dxl_id") for finger in chosen])
    return " ".join(finger["name"] for finger in chosen)


def joints_exchanged(told: File, rng: np.random.Generator) -> str:
    """Ids of the two joints of one finger."""
    (finger,) = _pick(told, rng)
    _exchange([(finger[joint], "dxl_id") for joint in _joints(finger)])
    return str(finger["name"])


def ring_turned(told: File, rng: np.random.Generator) -> str:
    """All fingers one place further round: what is bolted where is told wrongly, and nothing else."""
    fingers, by = told["fingers"], int(rng.integers(1, len(told["fingers"])))
    places = [{key: finger[key] for key in ("base_mm", "heading_deg")} for finger in fingers]
    for finger, place in zip(fingers, places[by:] + places[:by], strict=True):
        finger.update(place)
    return f"by {by}"


def frame_mirrored(told: File, _: np.random.Generator) -> str:
    """The y axis measured the other way round."""
    for finger in told["fingers"]:
        x, y = finger["base_mm"]
        finger["base_mm"] = [x, -y]
        finger["heading_deg"] = -finger["heading_deg"]
    return "y downwards"


def joint_sign(told: File, rng: np.random.Generator) -> str:
    """The sign of one joint."""
    (finger,) = _pick(told, rng)
    joint = _joints(finger)[int(rng.integers(2))]
    key = "mm_per_turn" if joint == "slide" else "gear_ratio"
    finger[joint][key] = -finger[joint].get(key, 1.0)
    return f"{finger['name']} {joint}"


def scale_wrong(told: File, rng: np.random.Generator) -> str:
    """Way of a slide in a turn, or a gear: of one finger, or of all as drawings are wrong for all."""
    factor = float(rng.choice([0.5, 2.0, 0.9, 1.1, math.pi / 3, 1.03]))
    chosen = told["fingers"] if rng.random() < 0.5 else _pick(told, rng)
    joint = _joints(chosen[0])[int(rng.integers(2))]
    key = "mm_per_turn" if joint == "slide" else "gear_ratio"
    for finger in chosen:
        finger[joint][key] = finger[joint].get(key, 1.0) * factor
    return f"{' '.join(f['name'] for f in chosen)} {joint} x {factor:.3g}"


def radius_wrong(told: File, rng: np.random.Generator) -> str:
    """The diameter given as the radius, or the other way round; of a pad its width."""
    factor = float(rng.choice([0.5, 2.0]))
    for finger in told["fingers"]:
        key = "width_mm" if "width_mm" in finger["tip"] else "radius_mm"
        finger["tip"][key] *= factor
    return f"x {factor:g}"


def horn_moved(told: File, rng: np.random.Generator) -> str:
    """A horn put on one tooth further: of 20 to 25 teeth."""
    (finger,) = _pick(told, rng)
    joint = _joints(finger)[int(rng.integers(2))]
    teeth = int(rng.integers(20, 26))
    if joint == "slide":
        finger[joint]["zero_mm"] += finger[joint]["mm_per_turn"] / teeth
    else:
        finger[joint]["zero_deg"] += 360.0 / teeth
    return f"{finger['name']} {joint} 1/{teeth}"


def base_off(told: File, rng: np.random.Generator) -> str:
    """A base measured 4 to 10 mm off."""
    (finger,) = _pick(told, rng)
    away, bearing = rng.uniform(4, 10), rng.uniform(0, 2 * math.pi)
    x, y = finger["base_mm"]
    finger["base_mm"] = [float(x + away * math.cos(bearing)), float(y + away * math.sin(bearing))]
    return f"{finger['name']} {away:.1f} mm"


def heading_off(told: File, rng: np.random.Generator) -> str:
    """A heading measured 3 to 8 degrees off."""
    (finger,) = _pick(told, rng)
    by = float(rng.choice([-1, 1]) * rng.uniform(3, 8))
    finger["heading_deg"] += by
    return f"{finger['name']} {by:.1f} deg"


def array_turned(told: File, rng: np.random.Generator) -> str:
    """The direction to which an array looks, off by a quarter or a half."""
    (finger,) = _pick(told, rng)
    by = float(rng.choice([90.0, 180.0, -90.0]))
    finger["array"]["heading_deg"] = finger["array"].get("heading_deg", 0.0) + by
    return f"{finger['name']} {by:g} deg"


def stiffness_wrong(told: File, rng: np.random.Generator) -> str:
    """Tips three times as stiff or as soft as told."""
    factor = float(rng.choice([1 / 3, 3.0]))
    for finger in told["fingers"]:
        finger["tip"]["stiffness_n_per_mm"] *= factor
    return f"x {factor:.2g}"


TOLD: Mapping[str, Callable[[File, np.random.Generator], str]] = {
    "arrays exchanged": arrays_exchanged,
    "ids exchanged": ids_exchanged,
    "joints exchanged": joints_exchanged,
    "ring turned": ring_turned,
    "frame mirrored": frame_mirrored,
    "joint sign": joint_sign,
    "scale wrong": scale_wrong,
    "radius wrong": radius_wrong,
    "horn moved": horn_moved,
    "base off": base_off,
    "heading off": heading_off,
    "array turned": array_turned,
    "stiffness wrong": stiffness_wrong,
}


# ----------------------------------------------------------------------------------------------------
# What another program left in servos: addresses and lengths of the e-Manual's control table of XM430


def _write(dxl_id: int, address: int, size: int, value: int) -> bytes:
    data = (value & (256**size - 1)).to_bytes(size, "little")
    parameters = address.to_bytes(2, "little") + data
    return encode_instruction(InstructionPacket(dxl_id, Instruction.WRITE, parameters))


def _near_ids(rig: File) -> list[int]:
    return [finger[_joints(finger)[0]]["dxl_id"] for finger in rig["fingers"]]


def _far_ids(rig: File) -> list[int]:
    return [finger[_joints(finger)[1]]["dxl_id"] for finger in rig["fingers"]]


def _offset(rig: File, rng: np.random.Generator) -> tuple[str, tuple[bytes, ...]]:
    ticks = int(rng.choice([-1, 1]) * rng.choice([rng.integers(20, 41), rng.integers(200, 1024)]))
    ids = _near_ids(rig) + _far_ids(rig)
    dxl_id = int(rng.choice(ids))
    return f"{ticks} ticks in {dxl_id}", (_write(dxl_id, 20, 4, ticks),)


def _gains(rig: File, rng: np.random.Generator) -> tuple[str, tuple[bytes, ...]]:
    p, d = int(rng.choice([0, 20, 100])), int(rng.choice([0, 16000]))
    ids = _near_ids(rig)
    return f"P {p}, D {d}", tuple(_write(i, 84, 2, p) + _write(i, 80, 2, d) for i in ids)


def _drive_mode(rig: File, rng: np.random.Generator) -> tuple[str, tuple[bytes, ...]]:
    mode = int(rng.choice([1, 4, 5]))
    ids = _near_ids(rig) + _far_ids(rig)
    return f"mode {mode}", tuple(_write(i, 10, 1, mode) for i in ids)


def _limits(rig: File, _: np.random.Generator) -> tuple[str, tuple[bytes, ...]]:
    ids = _near_ids(rig)
    return "PWM Limit 30", tuple(_write(i, 36, 2, 30) for i in ids)


def _silent(rig: File, rng: np.random.Generator) -> tuple[str, tuple[bytes, ...]]:
    level, dxl_id = int(rng.choice([0, 1])), int(rng.choice(_far_ids(rig)))
    return f"Status Return Level {level} in {dxl_id}", (_write(dxl_id, 68, 1, level),)


SERVOS: Mapping[str, Callable[[File, np.random.Generator], tuple[str, tuple[bytes, ...]]]] = {
    "homing offset": _offset,
    "gains": _gains,
    "drive mode": _drive_mode,
    "limits": _limits,
    "status return level": _silent,
}

# ----------------------------------------------------------------------------------------------------
# What a file declares, drawn up to it; encoders also beyond


def _encoders(setup: SetUp, rng: np.random.Generator, is_declared: bool = True) -> SetUp:
    """Encoders off by up to what is declared, or by as much where nothing is."""
    true, told, most = copy.deepcopy(setup.true), copy.deepcopy(setup.told), float(rng.uniform(0.6, 1.2))
    off = most * float(rng.uniform(0.5, 1.0)) if is_declared else most
    true["emulation"]["encoder_error_deg"] = off
    for truth, finger in zip(true["fingers"], told["fingers"], strict=True):
        truth["bounds"]["encoder_deg"] = most
        finger["bounds"]["encoder_deg"] = most if is_declared else 0.0
    return replace(setup, true=true, told=told, detail=f"{setup.detail} encoders {off:.2f} deg".strip())


def _is_legal(rig: File) -> bool:
    try:
        RigFile.model_validate(rig)
    except ValidationError:
        return False
    return True


def _offsets(setup: SetUp, rng: np.random.Generator) -> SetUp:
    """Homing Offsets that were in the servos when their zeros were measured, and are recorded."""
    true, told = copy.deepcopy(setup.true), copy.deepcopy(setup.told)
    for truth, finger in zip(true["fingers"], told["fingers"], strict=True):
        for joint in _joints(finger):
            for most in (1000, 300, 100, 0):  # a servo starts within one turn: not every zero is possible
                truth[joint]["homing_offset"] = finger[joint]["homing_offset"] = int(
                    rng.integers(-most, most + 1)
                )
                if _is_legal(true):
                    break
    return replace(setup, true=true, told=told, detail=f"{setup.detail} offsets".strip())


def _lags_as_declared(setup: SetUp, rng: np.random.Generator) -> SetUp:
    """A low-pass filter of each array that shows 99 % of a step within what is declared."""
    told, sensors = copy.deepcopy(setup.told), dict(setup.sensors)
    lags = []
    for finger in told["fingers"]:
        declared = float(rng.uniform(0.02, 0.15))
        finger["array"]["lag_s"] = declared
        lags.append(declared * float(rng.uniform(0.5, 1.0)) / math.log(100))
        sensors[finger["name"]] = partial(Lags, lags[-1])
    detail = f"{setup.detail} filters of {'/'.join(f'{lag * 1e3:.0f}' for lag in lags)} ms"
    return replace(setup, told=told, sensors=sensors, detail=detail.strip())


WITHIN: Mapping[str, tuple[Callable[[SetUp, np.random.Generator], SetUp], ...]] = {
    "encoders as declared": (_encoders,),
    "offsets as recorded": (_offsets,),
    "lags as declared": (_lags_as_declared,),
    "all as declared": (_encoders, _offsets, _lags_as_declared),
}
"""Not mistakes: drawn up to what the file declares."""

MISTAKES = (*TOLD, *SENSORS, *SERVOS, "encoders off")


def draw(rig: str, mistake: str, seed: int) -> SetUp:
    """Draw a set-up: the same numbers, the same set-up."""
    true = read(rig)
    rng = np.random.default_rng([seed, *Path(rig).stem.encode(), *mistake.encode()])
    setup = SetUp(rig, mistake, true, copy.deepcopy(true))
    if mistake in TOLD:
        return replace(setup, detail=TOLD[mistake](setup.told, rng))
    if mistake in SENSORS:
        detail, sensors = SENSORS[mistake](true, rng)
        return replace(setup, sensors=sensors, detail=detail)
    if mistake in SERVOS:
        detail, written = SERVOS[mistake](true, rng)
        return replace(setup, written=written, detail=detail)
    if mistake == "encoders off":
        return _encoders(setup, rng, is_declared=False)
    for change in WITHIN[mistake] if mistake != "right" else ():
        setup = change(setup, rng)
    return setup


def is_possible(rig: str, mistake: str) -> bool:
    """Return whether a rig can be wrong like that."""
    fingers = read(rig)["fingers"]
    if mistake == "array turned":
        return "width_mm" not in fingers[0]["tip"]
    return True
