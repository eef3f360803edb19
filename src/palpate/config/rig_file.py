"""Description of a rig, format `palpate/rig@1`: TOML in, one checked `RigFile` out.

It gives the ports of servos and arrays, the positions of the fingers, the bounds on all of these, and the
speeds and forces of motion. Checks across tables run while a `RigFile` is made, each raising at the key to
be changed, so that a rig that exists is one that fits. The values keep the file's units, which are the
suffixes of their names: mm, degrees, N, Hz; `rig` turns them into mm, rad, s, N where it builds the bench.
`docs/rig-file.md` explains every key.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from operator import attrgetter
from typing import Annotated, Any, Literal, Self, get_args

import shapely
from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from palpate.base.errors import InputError
from palpate.base.tips import Ability
from palpate.config.arm_finger import ArmFingerConfig
from palpate.config.fields import FileModel, Items, Name
from palpate.config.loading import Source, load_toml
from palpate.config.problems import TAG, Place, problem, problems_of, refuse
from palpate.config.rig_fingers import CurrentSensingConfig, FingerConfig
from palpate.config.rig_servos import RigServo, StageConfig
from palpate.config.rig_tables import (
    BusConfig,
    ClosingConfig,
    EmulationConfig,
    ObstacleConfig,
    SearchConfig,
    WorkspaceConfig,
)
from palpate.config.slide_finger import SlideFingerConfig

_MOCK_SCHEME = "mock://"
"""Ports of emulated devices begin so."""

_DRAWN_BY_STAGE = (
    ("stage_backlash_deg", "backlash_deg"),
    ("stage_error_deg", "bound_deg"),
    ("stage_centre_error_mm", "centre_bound_mm"),
)
_DRAWN_BY_ANY = (
    ("encoder_error_deg", "bounds.encoder_deg"),
    ("gain_spread", "array.gain_spread"),
    ("drift_counts_per_s", "array.drift_counts_per_s"),
    ("array_heading_error_deg", "array.heading_bound_deg"),
    ("stiffness_spread", "tip.stiffness_spread"),
    ("tip_radius_error_mm", "tip.radius_bound_mm"),
    ("base_error_mm", "bounds.base_mm"),
    ("heading_error_deg", "bounds.heading_deg"),
    ("deflection_mm_per_n", "bounds.deflection_mm_per_n"),
)
"""Keys of [emulation] and the declared bounds, by their places in a table, that they stay within."""


def _check_identities(fingers: Sequence[FingerConfig], bus: BusConfig, stage: StageConfig | None) -> None:
    """Refuse a finger name, a servo id on the bus or a port that is used twice."""
    names: dict[str, int] = {}
    servos: dict[int, str] = {}
    ports: dict[str, str] = {bus.port: "the bus"}
    shared: dict[str, str] = {}
    if stage is not None:
        servos[stage.dxl_id] = "the stage"
    for index, finger in enumerate(fingers):
        if finger.name in names:
            raise problem(f"fingers[{names[finger.name]}] has this name already", "fingers", index, "name")
        names[finger.name] = index
        for part, servo in finger.servos.items():
            if servo.dxl_id in servos:
                raise problem(
                    f"{servo.dxl_id} is the id of {servos[servo.dxl_id]} already; every servo on the bus "
                    "needs its own",
                    *("fingers", index, part, "dxl_id"),
                )
            servos[servo.dxl_id] = f'finger "{finger.name}" ({part})'
        port = finger.array.port
        if not finger.array.has_device:
            continue
        whole = port.partition("#")[0]
        if port in ports or whole in ports or (port == whole and whole in shared):
            owner = ports.get(port) or ports.get(whole) or shared[whole]
            raise problem(
                f'"{port}" is the port of {owner} already; every array needs its own; those of arrays on one '
                f'connection are "{whole}#1", "{whole}#2" and so on',
                *("fingers", index, "array", "port"),
            )
        ports[port] = f'finger "{finger.name}" (array)'
        if port != whole:
            shared[whole] = ports[port]


def check_places(fingers: Sequence[FingerConfig], radius: float, clearance_mm: float) -> None:
    """Refuse fingers that cannot wait outside the workspace, never reach into it, or start in each other.

    `radius`: of the circle round the origin that holds the workspace at every angle of the stage, mm.
    """
    for index, finger in enumerate(fingers):
        finger.check_place(radius, "fingers", index)
    for (_, first), (index, second) in combinations(enumerate(fingers), 2):
        apart = math.dist(first.start_tip_mm(radius), second.start_tip_mm(radius))
        gap = apart - first.tip.half_width_mm - second.tip.half_width_mm
        if gap < clearance_mm:
            raise problem(
                f'retracted, its tip is {gap:.4g} mm from that of finger "{first.name}"; '
                f"closing.clearance_mm asks for {clearance_mm:g}",
                *("fingers", index, "base_mm"),
            )


def _check_obstacles(
    obstacles: Sequence[ObstacleConfig],
    fingers: Sequence[FingerConfig],
    radius: float,
    clearance_mm: float,
) -> None:
    """Refuse an obstacle's name given twice, and one that a finger touches where it starts."""
    names: dict[str, int] = {}
    for index, obstacle in enumerate(obstacles):
        if obstacle.name in names:
            raise problem(
                f"obstacles[{names[obstacle.name]}] has this name already", "obstacles", index, "name"
            )
        names[obstacle.name] = index
        shape = shapely.Polygon(obstacle.outline_mm)
        for finger in fingers:
            body = shapely.LineString([finger.base_mm, finger.start_tip_mm(radius)])
            gap = shapely.distance(shape, body) - finger.tip.half_width_mm
            if gap < clearance_mm:
                raise problem(
                    f'is {gap:.4g} mm from finger "{finger.name}", retracted; '
                    f"closing.clearance_mm asks for {clearance_mm:g}",
                    *("obstacles", index, "outline_mm"),
                )


def _check_real(fingers: Sequence[FingerConfig], bus: BusConfig) -> None:
    """Refuse emulated ports of a rig without [emulation]."""
    for port, place in _ports(fingers, bus):
        if port.startswith(_MOCK_SCHEME):
            raise problem(f'"{port}" is an emulated port, but there is no [emulation] table', *place)


def _check_parts_move(
    fingers: Sequence[FingerConfig], holds_n: float | None, drawn: EmulationConfig | None
) -> None:
    """Refuse parts that move under tips of which it is not known how they move them."""
    for index, finger in enumerate(fingers):
        if (why := finger.tip.kind.cannot.get("move parts")) is None:
            continue
        text = f'is there, and the tip of fingers[{index}] ("{finger.name}") is a {finger.tip.shape}; {why}'
        if holds_n is not None:
            raise problem(f"{text}; hold parts down, and leave it out", "search", "part_holds_n")
        if drawn is not None and drawn.part is not None:
            raise problem(f"{text}; leave it out, so that parts lie still", "emulation", "part")


def _check_without_arrays(
    fingers: Sequence[FingerConfig], closing: ClosingConfig, holds_n: float | None, radius: float
) -> None:
    """Refuse fingers that sense by current, where that says too little; `radius`: of the workspace."""
    for index, finger in enumerate(fingers):
        if not isinstance(finger.array, CurrentSensingConfig):
            continue
        place = ("fingers", index, "array", "friction_n")
        if any(other.array.has_device for other in fingers):
            raise problem("is there, and other fingers have arrays: all or none must have one", *place)
        if not isinstance(finger, SlideFingerConfig):
            raise problem("is there, and only fingers on slides can sense by current", *place)
        if finger.tip.kind.has_face or not finger.tip.kind.is_upright:
            raise problem(f"is there, and the tip is {finger.tip.kind.with_article}: take a cylinder", *place)
        if holds_n is not None:
            raise problem(
                f'is there, and fingers[{index}] ("{finger.name}") has no array: it moves parts that are not '
                "held; clamp them, and leave it out",
                *("search", "part_holds_n"),
            )
        nearest_mm = max(math.hypot(*finger.base_mm) - radius, finger.slide.range_mm[0])
        hidden = finger.array.hidden_n(nearest_mm)
        if hidden > 2 * closing.contact_force_n:
            raise problem(
                f"and aim_friction_nmm may hide {hidden:.3g} N of a contact; closing.contact_force_n must be "
                f"half of that at least, {math.ceil(50 * hidden) / 100:g} N",
                *place,
            )


def _check_stops_known(fingers: Sequence[FingerConfig]) -> None:
    """Refuse a check of slips without stops of every finger's slide."""
    for index, finger in enumerate(fingers):
        if finger.stops_mm is None:
            raise problem(
                f'is true, and fingers[{index}] ("{finger.name}") has no slide.stops_mm to meet',
                *("search", "check_slips"),
            )


def _check_emulation(
    drawn: EmulationConfig,
    fingers: Sequence[FingerConfig],
    bus: BusConfig,
    stage: StageConfig | None,
    workspace_mm: float,
) -> None:
    """Refuse real ports, parts put outside the workspace, emulated errors beyond declared bounds."""
    for port, place in _ports(fingers, bus):
        if not port.startswith(_MOCK_SCHEME):
            raise problem(
                f'"{port}" is not an emulated port (mock://…), but there is an [emulation] table: remove '
                "that for a real rig, with the tables below it, or keep mock:// ports",
                *place,
            )
    if drawn.placement_radius_mm >= workspace_mm:
        raise problem(
            f"is {drawn.placement_radius_mm:g}; it must be below workspace.radius_mm ({workspace_mm:g})",
            *("emulation", "placement_radius_mm"),
        )
    if stage is not None:
        _check_drawn(drawn, stage, "stage", _DRAWN_BY_STAGE)
    for index, finger in enumerate(fingers):
        _check_drawn(drawn, finger, f"fingers[{index}]", (*finger.drawn_within, *_DRAWN_BY_ANY))
        _check_under_load(drawn, finger, index)


def _check_drawn(
    drawn: EmulationConfig,
    owner: FingerConfig | StageConfig,
    table: str,
    pairs: Sequence[tuple[str, str]],
) -> None:
    """Refuse emulated errors beyond the bounds that a table declares."""
    for key, declared in pairs:
        amount, bound = getattr(drawn, key), attrgetter(declared)(owner)
        if amount > bound:
            raise problem(
                f"is {amount:g}, beyond the bound {table}.{declared} = {bound:g}; "
                "widen the bound or emulate less",
                *("emulation", key),
            )


def _check_under_load(drawn: EmulationConfig, finger: FingerConfig, index: int) -> None:
    """Refuse emulated deflection or friction that turns or shears more than the finger declares."""
    lever_mm = finger.lever_mm
    turned = math.degrees(drawn.deflection_mm_per_n / lever_mm)
    declared = finger.bounds.deflection_deg_per_n
    if turned > declared:
        raise problem(
            f"is {drawn.deflection_mm_per_n:g}, which turns a tip {lever_mm:g} mm from its joint by "
            f"{turned:.3g}° per N, beyond the bound fingers[{index}].bounds.deflection_deg_per_n = "
            f"{declared:g}; widen the bound or emulate less",
            *("emulation", "deflection_mm_per_n"),
        )
    along = finger.give_mm_per_n(drawn.mechanics)
    if along + drawn.deflection_mm_per_n > finger.bounds.deflection_mm_per_n:
        raise problem(
            f"and emulation.deflection_mm_per_n let a tip give way by {along + drawn.deflection_mm_per_n:g} "
            f"mm per N, beyond the bound fingers[{index}].bounds.deflection_mm_per_n = "
            f"{finger.bounds.deflection_mm_per_n:g}; widen the bound or emulate less",
            *("emulation", "mechanics", "slide_deflection_mm_per_n"),
        )
    part = drawn.part
    if part is None:
        return
    friction = part.tip_friction[1] if isinstance(part.tip_friction, tuple) else part.tip_friction
    if friction > finger.tip.max_friction:
        raise problem(
            f"is {friction:g}, beyond the bound fingers[{index}].tip.max_friction = "
            f"{finger.tip.max_friction:g}; widen the bound or emulate less",
            *("emulation", "part", "tip_friction"),
        )


def _ports(fingers: Sequence[FingerConfig], bus: BusConfig) -> list[tuple[str, Place]]:
    """Every port and the place of its key."""
    arrays = [
        (finger.array.port, ("fingers", index, "array", "port"))
        for index, finger in enumerate(fingers)
        if finger.array.has_device
    ]
    return [(bus.port, ("bus", "port")), *arrays]


def _kind(value: Any) -> str | None:
    kind = value.get("type", "slide") if isinstance(value, dict) else getattr(value, "type", "slide")
    return TAG + kind if isinstance(kind, str) else None


_BY_TYPE = Discriminator(_kind, custom_error_type="finger_type", custom_error_message="type")
AnyFinger = Annotated[
    Annotated[SlideFingerConfig, Tag(TAG + "slide")] | Annotated[ArmFingerConfig, Tag(TAG + "two-link")],
    _BY_TYPE,
]
"""A finger of either type, by its key `type`."""


class RigFile(FileModel):
    """A bench rig of tactile fingers, `palpate/rig@1`."""

    format: Literal["palpate/rig@1"]
    name: Name
    bus: BusConfig
    workspace: WorkspaceConfig
    closing: ClosingConfig
    search: SearchConfig
    fingers: Items[AnyFinger] = Field(
        min_length=1, description="The fingers, in the order they are reported."
    )
    stage: StageConfig | None = Field(default=None, description="The turning stage, if there is one.")
    obstacles: Items[ObstacleConfig] = Field(default=[], description="What stands in the fingers' plane.")
    emulation: EmulationConfig | None = Field(default=None, description="Only for rigs with mock:// ports.")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        clearance = self.closing.clearance_mm
        _check_identities(self.fingers, self.bus, self.stage)
        check_places(self.fingers, self.clear_radius_mm, clearance)
        _check_obstacles(self.obstacles, self.fingers, self.clear_radius_mm, clearance)
        _check_parts_move(self.fingers, self.search.part_holds_n, self.emulation)
        _check_without_arrays(self.fingers, self.closing, self.search.part_holds_n, self.clear_radius_mm)
        if self.search.check_slips:
            _check_stops_known(self.fingers)
        if self.emulation is None:
            _check_real(self.fingers, self.bus)
        else:
            _check_emulation(self.emulation, self.fingers, self.bus, self.stage, self.workspace.radius_mm)
        return self

    @property
    def clear_radius_mm(self) -> float:
        """Radius round the ring's origin that holds the workspace at every angle of the stage."""
        if self.stage is None:
            return self.workspace.radius_mm
        most = math.radians(max(abs(angle) for angle in self.stage.range_deg))
        return self.workspace.radius_mm + 2 * math.hypot(*self.stage.centre_mm) * math.sin(
            min(most, math.pi) / 2
        )

    @property
    def servos(self) -> tuple[RigServo, ...]:
        """All servos on the bus, the stage's first, each finger's after one another."""
        stage = () if self.stage is None else (RigServo(None, "stage", self.stage.dxl_id, self.stage.model),)
        joints = ((finger.name, joint) for finger in self.fingers for joint in finger.servos.items())
        return (*stage, *(RigServo(name, joint, one.dxl_id, one.model) for name, (joint, one) in joints))

    @property
    def emulated(self) -> bool:
        """True if the devices are emulated rather than real."""
        return self.emulation is not None

    def why_not(self, ability: Ability) -> str | None:
        """Reason why the rig cannot do something, by the first array or tip that cannot; None if it can."""
        for finger in self.fingers:
            if (why := finger.array.cannot.get(ability)) is not None:
                return f"finger {finger.name}: {why}"
        return next(
            (
                f"finger {finger.name}: its tip is {finger.tip.kind.with_article}, and {why}"
                for finger in self.fingers
                if (why := finger.tip.kind.cannot.get(ability)) is not None
            ),
            None,
        )

    def require_arrays(self) -> None:
        """Raise InputError if fingers have no arrays."""
        if any(not finger.array.has_device for finger in self.fingers):
            raise InputError(f'rig "{self.name}" has no arrays: its fingers sense by Present Current')

    def require(self, ability: Ability) -> None:
        """Raise InputError with that reason, if there is one."""
        if (why := self.why_not(ability)) is not None:
            raise InputError(why)


def add_finger_type(name: str, table: type[FingerConfig]) -> None:
    """Let rig files have fingers of one more type, from now on."""
    field = RigFile.model_fields["fingers"]
    (known,) = get_args(field.annotation)
    union = get_args(known)[0] | Annotated[table, Tag(TAG + name)]
    field.annotation = list[Annotated[union, _BY_TYPE]]  # type: ignore[valid-type]
    RigFile.model_rebuild(force=True)


def load_rig(source: Source) -> RigFile:
    """Read and check the rig described in `source`.

    Raises:
        InputError: unreadable, wrong keys or values, or parts of the rig that do not go together; one line.

    """
    return load_toml(source, RigFile, {})


def change_tables(rig: RigFile, changes: Mapping[str, object], name: str) -> RigFile:
    """The rig with other values in some tables; those of a list, such as fingers, are given by their names.

    Checked as a rig file is; `name`: what messages call it. None takes a key away.
    """
    data = rig.model_dump(mode="json", exclude_unset=True)
    for key, value in changes.items():
        _change(data, key, value, name)
    try:
        return RigFile.model_validate(data)
    except ValidationError as error:
        raise refuse(name, problems_of(error, RigFile, data, {})) from None


def _change(table: dict[str, Any], key: str, value: object, place: str) -> None:
    before = table.get(key)
    if value is None:
        table.pop(key, None)
    elif not isinstance(value, Mapping):
        table[key] = value
    elif not isinstance(before, list | dict):
        table[key] = dict(value)
    elif isinstance(before, list):
        entries = {item["name"]: item for item in before}
        for entry, inner in value.items():
            if entry not in entries or not isinstance(inner, Mapping):
                raise InputError(f"{place}: {key}: there is none called {entry!r}; {', '.join(entries)}")
            for name, to in inner.items():
                _change(entries[entry], name, to, place)
    else:
        for name, to in value.items():
            _change(before, name, to, place)
