"""Driven tips: emulated parts and tips on given paths, in the emulated bench's engines, without devices.

There are no servos, arrays, bytes or frames. Where tips are is given, what they press with and where the
parts slide come out. `noise_of` says which forces an array does not notice, as the rig's own extractor does
when it is tared.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import FingerConfig, RigFile
from palpate.drivers.emulators import (
    Displacement,
    Displacements,
    Parts,
    PartSection,
    PointForce,
    Press,
    Skin,
    Taxels,
    TipLoad,
    separation_mm,
)
from palpate.drivers.tactile import ContactExtractor, TactileFrame
from palpate.rig.arrays import calibration_of
from palpate.rig.emulated.devices import description_of

_NOWHERE = np.full(2, np.inf)


class _DrivenContact:
    """A tip and one part: `outline`, its section at the tip's height as it was put."""

    def __init__(self, skin: Skin, height_mm: float, outline: PartSection) -> None:
        self.press: Press[TipLoad] | None = None
        self._skin, self._height_mm, self._outline = skin, height_mm, outline
        self._centre = _NOWHERE
        self._before: Press[TipLoad] | None = None
        self._found: dict[tuple[float, ...], Press[TipLoad] | None] = {}  # of this step

    def move_to(self, centre_mm: Floats) -> None:
        """Let the tip be elsewhere (2,), in W."""
        self._centre, self._before = centre_mm, self.press
        self._found.clear()

    def gap_mm(self, displacement: Displacement) -> float:
        """Distance from touching; negative where they touch."""
        return separation_mm(self._outline, displacement.back(self._centre)) - self._skin.radius_mm

    def meet(self, displacement: Displacement) -> None:
        """Let the tip meet the part where it has come to lie."""
        self.press = self._press(displacement)

    def forces_on(self, displacement: Displacement) -> list[PointForce]:
        """Forces on the part at a displacement."""
        found = self._press(displacement)
        return [] if found is None else found.on_part(self._centre, displacement, self._height_mm)

    def _press(self, displacement: Displacement) -> Press[TipLoad] | None:
        place = (*displacement.shift_mm.tolist(), displacement.turn_rad)
        if place not in self._found:
            shear = None if self._before is None else self._before.shear
            found = self._skin.press(self._outline, self._centre, displacement, shear)
            self._found[place] = found
        return self._found[place]


class DrivenTip:
    """One tip, against the outlines of parts at its height, as they were put; None of one that is lower."""

    def __init__(self, skin: Skin, height_mm: float, outlines: Iterable[PartSection | None]) -> None:
        self.skin = skin
        self._contacts = [
            None if outline is None else _DrivenContact(skin, height_mm, outline) for outline in outlines
        ]

    @property
    def loads(self) -> list[TipLoad]:
        """Loads of the parts that it touches."""
        presses = (None if contact is None else contact.press for contact in self._contacts)
        return [press.load for press in presses if press is not None]

    @property
    def force_n(self) -> float:
        """Force that its taxels bear together."""
        return sum((float(load.by_ray_n.sum()) for load in self.loads), 0.0)

    def move_to(self, centre_mm: Floats) -> None:
        """Be elsewhere (2,), in W."""
        for contact in self._contacts:
            if contact is not None:
                contact.move_to(centre_mm)

    def gap_mm(self, displacements: Displacements) -> float:
        """Distance from touching the nearest part; negative where it does."""
        return min((contact.gap_mm(by) for contact, by in self._contacts_at(displacements)), default=math.inf)

    def meet(self, displacements: Displacements) -> None:
        """Meet the parts where they have come to lie."""
        for contact, displacement in self._contacts_at(displacements):
            contact.meet(displacement)

    def forces_on(self, number: int, displacement: Displacement) -> list[PointForce]:
        """Forces on a part at a displacement."""
        contact = self._contacts[number]
        return [] if contact is None else contact.forces_on(displacement)

    def _contacts_at(self, displacements: Displacements) -> Iterator[tuple[_DrivenContact, Displacement]]:
        for contact, displacement in zip(self._contacts, displacements, strict=True):
            if contact is not None:
                yield contact, displacement


class DrivenTips:
    """All tips and the parts, in one time."""

    def __init__(self, parts: Parts, tips: Sequence[DrivenTip]) -> None:
        self.parts, self.tips = parts, tuple(tips)
        self._at_rest = True

    @property
    def is_at_rest(self) -> bool:
        """True if nothing has moved a part in the last step."""
        return self._at_rest

    def step(self, centres_mm: Sequence[Floats], dt_s: float) -> None:
        """Bring the tips to where they are then, (2,) each, and let the parts give way."""
        before = self.parts.displacements
        for tip, centre in zip(self.tips, centres_mm, strict=True):
            tip.move_to(centre)
            tip.meet(before)
        touched = any(tip.loads for tip in self.tips)
        self.parts.step(self._forces, touched, dt_s)
        self._at_rest = self.parts.displacements is before
        if not self._at_rest:
            for tip in self.tips:
                tip.meet(self.parts.displacements)

    def _forces(self, displacements: Displacements) -> list[list[PointForce]]:
        return [
            [force for tip in self.tips for force in tip.forces_on(number, displacement)]
            for number, displacement in enumerate(displacements)
        ]


_TARE_FRAMES = 64
_MOST_FRAMES = 64
_COLUMNS = 3  # on which a light contact is read


@dataclass(frozen=True, eq=False)
class ArrayNoise:
    """Noise of an array, which misses forces up to `least_n` in one frame, and less in the mean of more.

    `sigma_n`: standard deviation of what a frame reads. `shares` (n,): how much of it is left in the mean of
    1, 2, … frames.
    """

    least_n: float
    sigma_n: float
    shares: Floats

    def share(self, frames: int) -> float:
        """Share of it in the mean of so many frames."""
        return float(self.shares[frames - 1])


def noise_of(rig: RigFile, finger: FingerConfig) -> ArrayNoise:
    """Noise of a finger's array.

    A rig file that says nothing of emulated arrays has one that notices no less than the rig's threshold.
    """
    frames = np.arange(1, _MOST_FRAMES + 1)
    if rig.emulation is None:
        return ArrayNoise(rig.closing.contact_force_n, 0.0, 1 / np.sqrt(frames))
    description = description_of(finger, 0)
    taxels = Taxels(
        description,
        seed=0,
        noise_counts=rig.emulation.noise_counts,
        offset_counts=rig.emulation.offset_counts,
    )
    extractor = ContactExtractor(description, calibration_of(rig, finger, description))
    none = np.zeros((description.rows, description.cols))
    extractor.tare([TactileFrame(k, 0.0, 0.0, taxels.counts(none)) for k in range(_TARE_FRAMES)])
    least = min(extractor.least_force_n, rig.closing.contact_force_n)
    counts = rig.emulation.noise_counts * math.sqrt(_COLUMNS * description.rows)
    return ArrayNoise(
        least,
        counts / description.counts_per_n,
        np.array([extractor.noise_share(count) for count in frames.tolist()]),
    )
