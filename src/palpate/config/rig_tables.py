"""Tables of a rig file other than fingers: bus, workspace, closing, search, obstacles, emulation.

Units are the file's, which are the suffixes of the names. `docs/rig-file.md` explains every key.
"""

import logging
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from palpate.base.vocabulary import DEFAULT_BUDGET, LEAST_BUDGET
from palpate.config.emulation import (
    AdapterConfig,
    EmulatedPartConfig,
    MechanicsConfig,
    PartCountOrRange,
    Span,
)
from palpate.config.fields import Count, FileModel, Flag, Items, Length, Name, Point, Positive, Text, in_order
from palpate.config.outline_checks import outline_problem
from palpate.config.problems import problem
from palpate.config.rig_servos import Share

BUS_BAUDRATES = (9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000)
"""Rates that all supported servos know (e-Manual, Baud Rate (8))."""


class BusConfig(FileModel):
    """The bus that all servos share."""

    port: Text = Field(description="Device path, socket://host:port, or mock://name for an emulated bus.")
    baudrate_bps: Annotated[int, Field(strict=True)] = Field(
        description="Baud rate set in every servo.", json_schema_extra={"enum": list(BUS_BAUDRATES)}
    )
    latency_ms: Annotated[Positive, Field(le=1000)] | None = Field(
        default=None,
        description="What adapter and system may add to the time of an answer. Without it: from the "
        "adapter's latency timer where the system tells it, else 34.",
    )

    @model_validator(mode="after")
    def _baudrate_is_known(self) -> Self:
        if self.baudrate_bps not in BUS_BAUDRATES:
            allowed = ", ".join(str(rate) for rate in BUS_BAUDRATES)
            raise problem(f"is {self.baudrate_bps}; allowed: {allowed}", "baudrate_bps")
        return self


class WorkspaceConfig(FileModel):
    """Region in which parts may lie."""

    radius_mm: Positive = Field(
        description="Parts lie inside this circle round W's origin; fingers wait outside."
    )


class ClosingConfig(FileModel):
    """Closing of the fingers on a part."""

    approach_speed_mm_s: Annotated[Positive, Field(le=1000)] = Field(description="Speed through free space.")
    search_speed_mm_s: Annotated[Positive, Field(le=1000)] | None = Field(
        default=None,
        description="Speed where a finger may first meet the part; by default approach_speed_mm_s.",
    )
    retract_speed_mm_s: Annotated[Positive, Field(le=1000)] | None = Field(
        default=None,
        description="Speed on the way back from the part; by default approach_speed_mm_s.",
    )
    touch_speed_mm_s: Annotated[Positive, Field(le=100)] = Field(
        description="Speed when a contact is measured."
    )
    back_off_mm: Positive = Field(description="Way back from a first contact before touching again slowly.")
    contact_force_n: Positive = Field(description="Force that counts as a contact.")
    max_force_n: Annotated[Positive, Field(le=200)] = Field(description="No finger may ever press harder.")
    clearance_mm: Length = Field(description="Least gap between two fingers, or a finger and an obstacle.")
    sample_rate_hz: Annotated[Positive, Field(ge=1, le=10000)] = Field(
        description="Frames per second of an array."
    )

    @property
    def search_mm_s(self) -> float:
        """Speed (mm/s) at which a finger may meet the part for the first time."""
        return self.approach_speed_mm_s if self.search_speed_mm_s is None else self.search_speed_mm_s

    @property
    def retract_mm_s(self) -> float:
        """Speed (mm/s) on the way back from the part, which has just been gone."""
        return self.approach_speed_mm_s if self.retract_speed_mm_s is None else self.retract_speed_mm_s

    @model_validator(mode="after")
    def _grows_in_order(self) -> Self:
        if self.touch_speed_mm_s > self.approach_speed_mm_s:
            raise problem(
                f"is {self.touch_speed_mm_s:g}, above approach_speed_mm_s ({self.approach_speed_mm_s:g})",
                "touch_speed_mm_s",
            )
        if self.search_mm_s > self.approach_speed_mm_s:
            raise problem(
                f"is {self.search_mm_s:g}, above approach_speed_mm_s ({self.approach_speed_mm_s:g})",
                "search_speed_mm_s",
            )
        if self.contact_force_n >= self.max_force_n:
            raise problem(
                f"is {self.contact_force_n:g}, not below max_force_n ({self.max_force_n:g})",
                "contact_force_n",
            )
        return self


_RENAMED_KEYS = {
    "stranger_chance": "false_match_probability",
    "unnoticed_shift_mm": "detectable_shift_mm",
}
"""Old keys of [search], still read, and what they are called now."""


class SearchConfig(FileModel):
    """Goals and limits of an identification."""

    @model_validator(mode="before")
    @classmethod
    def _with_present_names(cls, table: Any) -> Any:
        """Take keys by their old names, too, and log it: on stderr, unless a program handles logging."""
        if not isinstance(table, Mapping):
            return table
        old = {key: new for key, new in _RENAMED_KEYS.items() if key in table and new not in table}
        for key, new in old.items():
            logging.getLogger(__name__).warning("notice: rig file: search.%s is now called %s", key, new)
        return {old.get(key, key): value for key, value in table.items()}

    max_grips: Annotated[int, Field(strict=True, ge=1, le=1000)] = Field(
        description="Grips before giving up."
    )
    max_seconds: Positive | None = Field(
        default=None,
        description="After so many seconds of rig time no further grip begins.",
    )
    false_match_probability: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] = Field(
        default=0.01,
        description="No answer is given while something that is not in the catalogue, different by 2 mm or "
        "more over a fifth of its outline from every part, would have agreed with all that was predicted "
        "with a greater probability than this.",
    )
    detectable_shift_mm: Positive = Field(
        default=10.0,
        description="The last grip before an answer must be able to detect a shift of the part by this.",
    )
    goal_position_mm: Positive = Field(description="Position bounds narrower than this (±) are fine enough.")
    goal_orientation_deg: Annotated[Positive, Field(le=180)] = Field(
        description="Orientation bounds narrower than this (±) are fine enough."
    )
    budget: Annotated[int, Field(strict=True, ge=LEAST_BUDGET, le=1_000_000_000)] = Field(
        default=DEFAULT_BUDGET,
        description="Units of work that one recognition may take: interpretations, cells and configurations "
        "tested against a contact. When they are spent, there are more hypotheses, with wider bounds.",
    )
    check_slips: Flag = Field(
        default=False,
        description="Before and after a run slides meet their back stops: none may have slipped between.",
    )
    part_holds_n: Positive | None = Field(
        default=None,
        description="No part slides below this horizontal force at its middle, N. Without it parts are taken "
        "to lie still.",
    )
    part_support_mm: Positive | None = Field(
        default=None,
        description="The support's mean distance from its geometric median is at least this. Without it: "
        "that of the lowest section, evenly loaded.",
    )


class ObstacleConfig(FileModel):
    """A part of the rig that stands in the fingers' plane: a post, a camera."""

    name: Name = Field(description="How messages call it.")
    outline_mm: Items[Point] = Field(
        min_length=3, description="Corners [x, y] in the support-plane frame W, in order round it."
    )

    @model_validator(mode="after")
    def _is_simple(self) -> Self:
        found = outline_problem(np.array(self.outline_mm, dtype=np.float64))
        if found is not None:
            point, what = found
            raise problem(what, "outline_mm", *(() if point is None else (point,)))
        return self


WireShare = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.5)]


class EmulationConfig(FileModel):
    """Errors of the emulated devices against this description. What they draw stays hidden from the host."""

    noise_counts: Length = Field(default=0.0, description="Standard deviation of a taxel's noise.")
    offset_counts: Length = Field(default=0.0, description="Every taxel at rest reads this.")
    gain_spread: Share = Field(default=0.0, description="Taxel gains differ by up to this share.")
    drift_counts_per_s: Length = Field(default=0.0, description="Taxels' zeros wander this fast at most.")
    lag_s: Length = Field(
        default=0.0,
        description="Arrays' firmware filters: a step shows to 99 % after so long at most; the seed draws.",
    )
    crosstalk: Annotated[Length, Field(le=0.25)] = Field(
        default=0.0, description="Share of a taxel's pressure that each neighbour shows."
    )
    backlash_mm: Length = Field(default=0.0, description="Play of the slides, either way.")
    aim_backlash_deg: Length = Field(default=0.0, description="Play of the aims, either way.")
    joint_backlash_deg: Length = Field(default=0.0, description="Play of arms' joints, either way.")
    joint_zero_error_deg: Length = Field(
        default=0.0, description="Angles of arms' joints are off by up to this, besides their play."
    )
    link_error_mm: Length = Field(default=0.0, description="Lengths of arms' links are off by up to this.")
    encoder_error_deg: Length = Field(
        default=0.0,
        description="Encoders of fingers' servos are off by up to this, in waves of one and of two periods a "
        "turn.",
    )
    base_error_mm: Length = Field(
        default=0.0, description="Bases are up to this far from where they should be."
    )
    heading_error_deg: Length = Field(default=0.0, description="Headings are off by up to this.")
    tip_radius_error_mm: Length = Field(default=0.0, description="Radii of tips are off by up to this.")
    tip_length_mm: Positive | None = Field(
        default=None,
        description="Tips are in truth so long, or as far as the table; absent: as length_mm says.",
    )
    array_heading_error_deg: Length = Field(
        default=0.0, description="Arrays sit turned on their tips by up to this."
    )
    zero_error_mm: Length = Field(default=0.0, description="Zeros of slides are off by up to this.")
    mm_per_turn_error: Share = Field(
        default=0.0, description="Travels per turn of slides are off by up to this share."
    )
    dead_taxels: Count = Field(default=0, description="So many taxels of each array are stuck at 0.")
    stage_backlash_deg: Length = Field(default=0.0, description="Play of the turning stage, either way.")
    stage_error_deg: Length = Field(default=0.0, description="The stage's angle is off by up to this.")
    stage_centre_error_mm: Length = Field(
        default=0.0, description="The stage's axis is up to this far from where it should be."
    )
    stiffness_spread: Share = Field(default=0.0, description="Tips are harder or softer by up to this share.")
    deflection_mm_per_n: Annotated[Length, Field(le=1)] = Field(
        default=0.0,
        description="Forces on tips turn aims and arms' joints elastically: tips give way by up to this.",
    )
    play_holds_n: Annotated[tuple[Length, Length], AfterValidator(in_order)] | None = Field(
        default=None,
        description="[lo, hi], drawn for each finger: a greater force on the tip pushes aims and arms' "
        "joints to the flanks of their play; absent: none does.",
    )
    flipped_bytes: WireShare = Field(
        default=0.0, description="Share of bytes with a flipped bit, on every wire, both ways."
    )
    lost_packets: WireShare = Field(default=0.0, description="Share of packets that get lost, likewise.")
    array_boot_s: Annotated[Length, Field(le=10)] = Field(
        default=0.0, description="Arrays reset as their ports open, and are deaf for so long."
    )
    array_reset_s: Span | None = Field(
        default=None,
        description="[lo, hi]: so long after the start one array, drawn by the seed, resets; absent: none.",
    )
    bus_adapter: AdapterConfig | None = Field(
        default=None, description="The bus's USB adapter; absent: bytes pass as on a wire."
    )
    array_adapter: AdapterConfig | None = Field(
        default=None, description="Each array's USB adapter, likewise."
    )
    parts: PartCountOrRange = Field(
        default=1, description="So many parts lie on the table; the seed draws from [lo, hi]."
    )
    placement_radius_mm: Positive = Field(
        description="Parts are put with their centre of area inside this circle, "
        "inside the workspace if they fit."
    )
    start: Literal["waiting", "anywhere"] = Field(
        default="waiting",
        description="Where slides and their aims stand when they are switched on: retracted at aim 0, or "
        "anywhere in their travel and range, drawn by the seed.",
    )
    mechanics: MechanicsConfig | None = Field(
        default=None, description="What is different about friction, motors, supply, cables and screws."
    )
    part: EmulatedPartConfig | None = Field(
        default=None, description="Whether the part moves when it is pushed; absent: it stands still."
    )
