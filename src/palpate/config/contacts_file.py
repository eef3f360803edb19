"""Contacts, format `palpate/contacts@1`: touches and misses, grip by grip.

Everything is in the support-plane frame W, mm and rad. The values keep the file's field names, which carry
no unit suffix: the file's `units` header fixes them.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from palpate.base.tips import TipShape
from palpate.config.fields import FileModel, Flag, Items, Length, Name, Number, Point
from palpate.config.loading import Source, load_json
from palpate.config.problems import problem

CONTACT_NOUNS = {"grips": "grip", "contacts": "contact"}
"""Names of the entries of a file's lists in messages."""

_ANGLE_SLACK_RAD = 1e-9


def _normal_range(pair: tuple[float, float]) -> tuple[float, float]:
    lo, hi = pair
    if hi < lo:
        raise problem(f"is [{lo:g}, {hi:g}]; hi is counter-clockwise from lo, add 2π to hi if it wraps")
    if hi - lo > 2 * math.pi + _ANGLE_SLACK_RAD:
        raise problem(f"is [{lo:g}, {hi:g}], more than a full turn; leave it out if the normal is unknown")
    return pair


class ApproachEntry(FileModel):
    """Way of a finger: a straight line of the tip's centre."""

    direction: Number = Field(description="Direction of travel, rad, counter-clockwise from +x of W.")
    start: Point = Field(description="Tip centre at the start, mm; nothing was touched there.")
    end: Point | None = Field(default=None, description="Tip centre at the end of a miss, mm.")


class ContactEntry(FileModel):
    """One finger's approach: a touch (`centre`, perhaps `normal`) or a miss (`approach.end`)."""

    finger: Name
    touched: Flag
    height: Length = Field(description="Height of the contact above the support plane, mm.")
    tip_radius: Length = Field(description="Radius of the tip, mm; 0 is the point finger.")
    tip_shape: TipShape = Field(
        default=TipShape.CYLINDER,
        description="Shape of the tip: an upright cylinder, or a ball with its equator at `height`.",
    )
    tip_length: Annotated[Length, Field(le=1e4)] = Field(
        default=0.0,
        description="Length of the tip's straight part, its middle at `height`, mm; 0: as thin as a disc.",
    )
    position_bound: Length = Field(description="The true tip centre is within this distance, mm.")
    friction: Length | None = Field(
        default=None,
        description="Largest coefficient, if friction alone brought the finger to rest.",
    )
    path_bound: Length | None = Field(
        default=None,
        description="The same along the way there, mm: more where a tip may be dented unfelt; "
        "without it, position_bound.",
    )
    centre: Point | None = Field(default=None, description="Tip centre at the touch, mm.")
    normal: Annotated[tuple[Number, Number], AfterValidator(_normal_range)] | None = Field(
        default=None, description="Outward surface normal, rad, counter-clockwise from lo to hi."
    )
    approach: ApproachEntry

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        self._check_tip()
        if self.path_bound is not None and self.path_bound < self.position_bound:
            raise problem(
                f"is {self.path_bound:g}, less than position_bound ({self.position_bound:g})", "path_bound"
            )
        if self.touched:
            if self.centre is None:
                raise problem('a finger that touched needs the key "centre"')
            if self.approach.end is not None:
                raise problem(
                    "a finger that touched stopped at its centre; leave the end out", "approach", "end"
                )
            self._check_travel(self.centre, "centre")
            return self
        for key in ("centre", "normal"):
            if getattr(self, key) is not None:
                raise problem("a finger that touched nothing has none; leave it out", key)
        if self.approach.end is None:
            raise problem('a finger that touched nothing needs the key "end"', "approach")
        self._check_travel(self.approach.end, "approach", "end")
        return self

    def _check_tip(self) -> None:
        """Refuse a tip that reaches below the support plane, or of which contacts in files say too little."""
        tip = self.tip_shape.tip
        if (why := tip.cannot.get("plan")) is not None:
            raise problem(f'is "{self.tip_shape}"; {why}', "tip_shape")
        if self.tip_length and "length_mm" in tip.lacks:
            raise problem(tip.lacks["length_mm"], "tip_length")
        if tip.half_height_mm(self.tip_radius, self.tip_length / 2) > self.height:
            key = "tip_" + tip.half_height_key.removesuffix("_mm")
            raise problem(
                f"is {getattr(self, key):g}, too much for a {tip.noun} at height {self.height:g}: it would "
                "reach below the support plane",
                key,
            )

    def _check_travel(self, end: tuple[float, float], *place: str) -> None:
        """Refuse an end behind the start: direction and points contradict each other."""
        x, y = end[0] - self.approach.start[0], end[1] - self.approach.start[1]
        along = x * math.cos(self.approach.direction) + y * math.sin(self.approach.direction)
        if along < -2 * self.position_bound - _ANGLE_SLACK_RAD:
            raise problem(f"lies {-along:.4g} mm behind the start, against the direction of travel", *place)


class GripEntry(FileModel):
    """Approaches carried out together, each finger at most once."""

    contacts: Items[ContactEntry] = Field(min_length=1)

    @model_validator(mode="after")
    def _fingers_differ(self) -> Self:
        seen: dict[str, int] = {}
        for index, contact in enumerate(self.contacts):
            name = contact.finger
            first = seen.setdefault(name, index)
            if first != index:
                raise problem(
                    f'"{name}" is contact {first} of this grip already; start a new grip',
                    "contacts",
                    index,
                    "finger",
                )
        return self


class ContactsFile(FileModel):
    """Grips in the order in which they were carried out."""

    format: Literal["palpate/contacts@1"]
    units: Literal["mm, rad"]
    grips: Items[GripEntry] = Field(min_length=1)


def load_contacts(source: Source) -> ContactsFile:
    """Read and check the contacts in `source`.

    Raises:
        InputError: unreadable, wrong keys or values, or a contact that contradicts itself; one line.

    """
    return load_json(source, ContactsFile, CONTACT_NOUNS)
