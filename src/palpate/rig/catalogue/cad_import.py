"""CAD import: makes object models of the parts of a CAD file.

`tolerance_mm` is divided among curves that become edges, states that are nearly the same, and cross sections
that represent a range of heights. Their actual deviations are added up and written as the object's
tolerance.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Self, TypeVar

import numpy as np

from palpate.base.confined_reading import read_confined
from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.geometry.outlines import region_of
from palpate.cad.parts import Drawing, DrawingFile, Solid
from palpate.cad.readers import is_drawing, read_drawings, read_solids, simpler_file_advice
from palpate.cad.revolution import solid_of_revolution
from palpate.cad.solid_symmetries import NEGLIGIBLE_SHARE, with_symmetry
from palpate.cad.stable_states import volume_mm3
from palpate.config.catalogue_results import ImportedObjectOut, ImportedStateOut, OmittedStatesOut
from palpate.config.objects_file import FLAT, objects_from_text
from palpate.config.objects_tables import ObjectsFileText, ObjectText, SectionText, StateText
from palpate.rig.catalogue.import_states import (
    Height,
    ImportedStates,
    Shares,
    bound_mm,
    edge_count,
    frame_out,
    import_states,
    polygons_text,
    round_coordinate,
)
from palpate.rig.catalogue.round_outlines import RoundDrawing, round_drawing

Report = Callable[[str], None]
_Part = TypeVar("_Part")

_CURVE_SHARE, _REVOLVED_SHARE, _MERGED_SHARE = 0.06, 0.04, 0.3  # the last one of what the others leave
_BALL_SHARE = 0.5  # of the tolerance: a ball's facets are states otherwise, each improbable
_ROUND_SHARE = 0.03  # of the tolerance, for the curves of a drawing that is round
_NAMED_LOSS, _TOLERATED_LOSS, _MAX_LOSS = 0.005, 0.05, 0.2  # of resting probability, in states left out
_ORIGIN_DECIMALS = 3
_MAX_NAMES_SHOWN = 12  # parts in a message
_GRAVITY_M_S2, _HOLDS_STEPS_PER_N = 9.81, 1000.0

_TURN_UP = {
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}
"""Rotations that bring an axis to +z."""


class LossError(InputError):
    """Refusal to leave out too much of the ways in which a part rests."""


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import.

    `units`: of files that say none. `name`: instead of the file's. `tolerance_mm`: what approximations may
    add up to; `deviation_mm`: how far the made part may be from the file's. `heights_mm`: near which
    sections are wanted, of two from one to the other, None: all. `thickness_mm`: of a drawing; `layers`: the
    ones of a DXF file that have outlines, none named: all. `parts`: names, or numbers from 1, of those that
    are wanted of a file. `as_is`: not dropped, but as it lies in the file. States that are less probable than
    `least_probability` are left out. `accept_loss`: even if they are a fifth of all cases together, or more.
    `up`: axis of the file that points up where it is imported `as_is`. `part_holds_n`: force below which the
    part does not slide; without it, that follows from `friction` and the mass, or the density. `tags`: words
    by which lists choose.
    """

    units: str | None = None
    name: str | None = None
    tolerance_mm: float = 0.1
    deviation_mm: float = 0.0
    heights_mm: tuple[Height, ...] | None = None
    thickness_mm: float | None = None
    as_is: bool = False
    least_probability: float = 0.01
    accept_loss: bool = False
    layers: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    up: str | None = None
    part_holds_n: float | None = None
    mass_g: float | None = None
    density_g_cm3: float | None = None
    friction: float | None = None
    tags: tuple[str, ...] = ()

    @classmethod
    def of(cls, settings: Mapping[str, object], heights_mm: tuple[Height, ...] | None) -> Self:
        """Options by settings, checked ones (`config.import_settings`)."""
        said = {key: value for key, value in settings.items() if key not in ("states", "leave_out")}
        return cls(**said, as_is=settings.get("states") == "as-is", heights_mm=heights_mm)  # type: ignore[arg-type]

    @property
    def turn_up(self) -> Floats:
        """Rotation (3, 3) that brings the axis `up` of the file to +z, if it is imported as it is."""
        return np.array(_TURN_UP[self.up if self.as_is and self.up else "+z"], dtype=np.float64)

    def mass_of_g(self, volume_mm3: float) -> float | None:
        """Mass (g) of a part of a volume; None: not said."""
        if self.mass_g is not None or self.density_g_cm3 is None:
            return self.mass_g
        return self.density_g_cm3 * volume_mm3 / 1000.0

    def holds_n(self, volume_mm3: float) -> float | None:
        """Force (N) below which a part of a volume does not slide, rounded down; None: not said."""
        if self.part_holds_n is not None:
            return self.part_holds_n
        mass_g = self.mass_of_g(volume_mm3)
        if mass_g is None or self.friction is None:
            return None
        force = self.friction * mass_g / 1000.0 * _GRAVITY_M_S2
        return math.floor(force * _HOLDS_STEPS_PER_N) / _HOLDS_STEPS_PER_N or None


@dataclass(frozen=True)
class ImportedObject:
    """An imported object: its text in an objects file, and its entry in the result."""

    text: ObjectText
    result: ImportedObjectOut


@dataclass(frozen=True)
class Imported:
    """Every part of a file; `refused`: parts of which no object was made, and why, a line each."""

    objects: tuple[ImportedObject, ...]
    warnings: tuple[str, ...]
    refused: tuple[str, ...] = ()


def import_file(path: Path, options: ImportOptions, report: Report = lambda _: None) -> Imported:
    """Read a file and make an object of each of its parts; `report` hears what is being done.

    A part that is refused does not cost the others. Raises InputError for a file without any sound part, and
    if the tolerance allows sections of none; LossError where the states that are left out of the first are
    more than a fifth of all cases.
    """
    report(f"reading {path.name}")
    return _drawings(path, options) if is_drawing(path) else _solids(path, options, report)


def _check_model(where: str, item: ImportedObject) -> None:
    """Raise InputError for a model that could not be read again: it must not cost what is beside it."""
    text = ObjectsFileText(format="palpate/objects@1", units="mm", objects=[item.text])
    try:
        objects_from_text(text, item.text.name)
    except InputError as error:
        reason = str(error).removeprefix(f"{item.text.name}: ")
        raise InputError(
            f"{where}its model would be no sound one: {reason}; another tolerance may help"
        ) from None


def _solids(path: Path, options: ImportOptions, report: Report) -> Imported:
    if options.thickness_mm is not None:
        raise InputError(f"a thickness is for drawings; {path} holds solids, which have heights of their own")
    if options.layers:
        raise InputError(f"layers are for DXF files; {path} holds solids")
    curve = _CURVE_SHARE * options.tolerance_mm
    found = read_confined(path, simpler_file_advice(path), read_solids, path, options.units, curve)
    warnings = [f"{path}: left out: {', '.join(found.left_out)}"] if found.left_out else []
    names = _part_names([solid.name for solid in found.solids])
    made, refused = list[_Made](), [] if options.parts else [*found.refused]
    problem: InputError | None = None
    _check_asked(path, found.refused, names, options)
    for drawn, name in _select_parts(path, found.solids, names, options):
        try:
            made.append(_import_solid(drawn, name, options, partial(_report_of, report, name)))
        except InputError as error:
            problem = problem or type(error)(f"{path}: {error}")
            refused.append(str(error))
    if problem is not None and not made:
        raise problem
    warnings += [text for item in made for text in item.warnings]
    return Imported(tuple(item.object for item in made), tuple(warnings), tuple(refused))


@dataclass(frozen=True)
class _Made:
    """An object, and what is to be said of it."""

    object: ImportedObject
    warnings: tuple[str, ...]


def _import_solid(drawn: Solid, name: str, options: ImportOptions, report: Report) -> _Made:
    """The object of a solid. Raises InputError if none can be made, LossError if too much is left out."""
    upright = replace(drawn, vertices_mm=drawn.vertices_mm @ options.turn_up.T)
    within = max(_REVOLVED_SHARE * options.tolerance_mm, drawn.off_mm)
    solid = solid_of_revolution(upright, within, _BALL_SHARE * options.tolerance_mm)
    solid = solid or upright
    shares = _shares(solid, options)
    if solid.symmetry is None and not options.as_is:
        solid = with_symmetry(solid, NEGLIGIBLE_SHARE * shares.merged_mm)
    imported = import_states(solid, shares, report)
    lost = sum(item.probability for item in imported.left_out)
    if lost > _MAX_LOSS and not options.accept_loss:
        raise LossError(f"{_loss(name, imported.left_out)}; accept the loss to import it without them")
    made = _solid_object(solid, name, imported, options)
    _check_model(f"{name}: ", made)
    said = [f'object "{name}": {text}' for text in (*imported.warnings, *drawn.mended)]
    return _Made(made, (*said, *([_loss(name, imported.left_out)] if lost > _TOLERATED_LOSS else [])))


def _loss(name: str, left_out: Sequence[OmittedStatesOut]) -> str:
    lost = sum(item.probability for item in left_out)
    some = [item for item in left_out if item.probability >= _NAMED_LOSS]
    reasons = ", ".join(f"{100 * item.probability:.0f} % {item.reason}" for item in some)
    return (
        f'object "{name}" comes to rest in states that are left out in {100 * lost:.0f} % of cases '
        f"({reasons}), and is not recognised then"
    )


def _report_of(report: Report, name: str, what: str) -> None:
    report(f"{name}: {what}")


def _shares(solid: Solid, options: ImportOptions) -> Shares:
    merged = 0.0 if options.as_is else _MERGED_SHARE * (options.tolerance_mm - solid.off_mm)
    return Shares(
        options.tolerance_mm - merged,
        merged,
        options.heights_mm,
        options.least_probability,
        as_is=options.as_is,
        deviation_mm=options.deviation_mm,
    )


def _part_names(found: Sequence[str]) -> list[str]:
    """A name for each part, all different: those in the file, with numbers where they are equal."""
    names: list[str] = []
    for name in found:
        plain, number, taken = _printable(name), 1, name in names
        while taken or plain in names:
            number, taken = number + 1, False
            plain = f"{_printable(name)}-{number}"
        names.append(plain)
    return names


def _select_parts(
    path: Path, parts: Sequence[_Part], names: Sequence[str], options: ImportOptions
) -> list[tuple[_Part, str]]:
    """Parts, all or those asked for, and what to call them. Raises InputError for one that is missing.

    They are called as in the file, or as the options say, with numbers if there are several.
    """
    numbers = {str(k): name for k, name in enumerate(names, 1)}
    asked = [name if name in names else numbers.get(name) for name in options.parts]
    if None in asked:
        there = ", ".join(f'{number} "{name}"' for number, name in [*numbers.items()][:_MAX_NAMES_SHOWN])
        more = f" and {len(names) - _MAX_NAMES_SHOWN} more" if len(names) > _MAX_NAMES_SHOWN else ""
        raise InputError(f'{path}: has no part "{options.parts[asked.index(None)]}"; it has {there}{more}')
    pairs = [(part, name) for part, name in zip(parts, names, strict=True) if not asked or name in asked]
    if options.name is None or len(pairs) == 1:
        return [(part, options.name or name) for part, name in pairs]
    return [(part, f"{options.name}-{number}") for number, (part, _) in enumerate(pairs, 1)]


def _check_asked(path: Path, refused: Sequence[str], names: Sequence[str], options: ImportOptions) -> None:
    """Raise InputError if a part that is asked for was refused by the reader."""
    for name in options.parts:
        for line in refused:
            if name not in names and line.startswith(f"{name}: "):
                raise InputError(f"{path}: {line}")


def _printable(name: str) -> str:
    kept = "".join(letter if letter.isprintable() else " " for letter in name)
    return " ".join(kept.split())[:90] or "part"


def _solid_object(
    solid: Solid, name: str, imported: ImportedStates, options: ImportOptions
) -> ImportedObject:
    tolerance = bound_mm([max(item.off_mm for item in imported.states), options.deviation_mm])
    out = ImportedObjectOut(
        name=name,
        replaced=False,
        size=tuple(np.ptp(solid.vertices_mm, axis=0).tolist()),
        volume=volume_mm3(solid),
        facets=len(solid.faces),
        tolerance=tolerance,
        curve_tolerance=bound_mm([solid.off_mm]),
        deviation=options.deviation_mm,
        states=tuple(_in_file_frame(item.result, options) for item in imported.states),
        left_out=imported.left_out,
    )
    states = [
        item.text.model_copy(update={"down": _down(result)})
        for item, result in zip(imported.states, out.states, strict=True)
    ]
    return _make_object(out, states, out.size, volume_mm3(solid), options)


def _in_file_frame(state: ImportedStateOut, options: ImportOptions) -> ImportedStateOut:
    """The state with the frame of the file itself, before it was turned up."""
    rotation = np.array(state.frame.rotation) @ options.turn_up
    return state.model_copy(update={"frame": frame_out(rotation, np.array(state.frame.offset))})


def _down(state: ImportedStateOut) -> tuple[float, float, float]:
    """Direction of the file that points down in a state."""
    x, y, z = (round(-float(value), 4) + 0.0 for value in state.frame.rotation[2])
    return x, y, z


def _drawings(path: Path, options: ImportOptions) -> Imported:
    thickness = options.thickness_mm
    if thickness is None:
        raise InputError(
            f"{path} is a drawing, which says nothing of heights: give the thickness of the part"
        )
    found = _read_drawings(path, options, options.tolerance_mm)
    names = _part_names([drawing.name for drawing in found.drawings])
    pairs = _select_parts(path, found.drawings, names, options)
    rest = (f"{path}: left out of the drawing: {', '.join(found.left_out)}",) if found.left_out else ()
    circles = _circles(path, pairs, options)
    objects = [_flat_object(drawing, name, circles.get(name), thickness, options) for drawing, name in pairs]
    for item in objects:
        _check_model(f"{path}: ", item)
    return Imported(tuple(objects), rest)


def _read_drawings(path: Path, options: ImportOptions, curve_mm: float) -> DrawingFile:
    asked = path, options.units, curve_mm, options.layers
    return read_confined(path, simpler_file_advice(path), read_drawings, *asked)


def _circles(
    path: Path, pairs: Sequence[tuple[Drawing, str]], options: ImportOptions
) -> dict[str, RoundDrawing]:
    """Round ones among drawings, by name; read anew, as chords of the usual length say it only nearly."""
    nearly = 2 * options.tolerance_mm
    coarse = {name: found for drawing, name in pairs if (found := round_drawing(drawing, nearly))}
    if not coarse:
        return {}
    again = _read_drawings(path, options, _ROUND_SHARE * options.tolerance_mm).drawings
    fine = [found for drawing in again if (found := round_drawing(drawing, options.tolerance_mm))]
    # Parts do not overlap: what has this centre and this radius is this part, whatever the order is now.
    return {name: found for name, about in coarse.items() for found in fine if found.is_near(about, nearly)}


def _flat_object(
    drawing: Drawing, name: str, circles: RoundDrawing | None, thickness_mm: float, options: ImportOptions
) -> ImportedObject:
    """A drawing is an object with one state, its centre of area above the origin, to a micrometre."""
    area = region_of([drawing.outline])
    height = round_coordinate(thickness_mm)
    if circles is None:
        x, y = round(area.centroid.x, _ORIGIN_DECIMALS), round(area.centroid.y, _ORIGIN_DECIMALS)
        polygons, off = polygons_text((drawing.outline,), (x, y)), drawing.off_mm
    else:
        (x, y), polygons, off = circles.centre_mm, [circles.polygon()], circles.off_mm
    section = SectionText(z=(0.0, height), polygons=polygons)
    result = ImportedStateOut(
        name=FLAT,
        probability=None,
        tipping_angle=None,
        height=height,
        heights=None,
        sections=1,
        edges=(edge_count(section),) * 2,
        merged=1,
        section_tolerance=0.0,
        merged_tolerance=0.0,
        frame=frame_out(np.eye(3), np.array([-x, -y, 0.0])),
    )
    tolerance = bound_mm([off, options.deviation_mm])
    west, south, east, north = area.bounds if circles is None else circles.bounds_mm
    out = ImportedObjectOut(
        name=name,
        replaced=False,
        size=(east - west, north - south),
        volume=None,
        facets=None,
        tolerance=tolerance,
        curve_tolerance=bound_mm([off]),
        deviation=options.deviation_mm,
        states=(result,),
        left_out=(),
    )
    state = StateText(name=FLAT, height=height, sections=[section])
    return _make_object(out, [state], (*out.size, height), area.area * height, options)


def _make_object(
    out: ImportedObjectOut,
    states: list[StateText],
    size_mm: Sequence[float],
    volume_mm3: float,
    options: ImportOptions,
) -> ImportedObject:
    """The entry `out` of the result with the text of the objects file."""
    width, depth, height = (round(item, 3) for item in size_mm)
    mass_g = options.mass_of_g(volume_mm3)
    text = ObjectText(
        name=out.name,
        tolerance=out.tolerance,
        size=(width, depth, height),
        mass_g=None if mass_g is None else round(mass_g, 3),
        tags=list(options.tags) or None,
        states=states,
        part_holds_n=options.holds_n(volume_mm3),
    )
    return ImportedObject(text, out)
