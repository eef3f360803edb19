"""The objects file that an import writes: options within their limits, and what the file held before."""

import math
from pathlib import Path

from palpate.api.files import load_rig
from palpate.config.objects_file import load_objects, load_objects_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.errors import InputError
from palpate.files.writing import check_place
from palpate.rig.catalogue.cad_import import ImportOptions

__all__ = ["check_options", "heights_of", "load_target", "wanted_heights"]

_LEAST_TOLERANCE_MM, _MOST_TOLERANCE_MM = 0.001, 5.0
_MOST_THICKNESS_MM = 1000.0


def heights_of(text: str) -> tuple[float, ...]:
    """The heights of "5,12", ascending. Raises InputError."""
    found = set()
    for part in text.split(","):
        try:
            height = float(part)
        except ValueError:
            height = math.nan
        if not 0 <= height < math.inf:
            raise InputError(f'--heights "{text}": "{part}" is no height in mm; write them as 5,12')
        found.add(height)
    return tuple(sorted(found))


def wanted_heights(rig: Path | None, heights: str | None, *, all_heights: bool) -> tuple[float, ...] | None:
    """The heights asked for, or those of a rig's fingers, ascending; None: all. Raises InputError."""
    if sum((rig is not None, heights is not None, all_heights)) > 1:
        raise InputError("give one of --rig, --heights and --all-heights")
    if all_heights:
        return None
    if heights is not None:
        return heights_of(heights)
    return tuple(sorted({finger.height_mm for finger in load_rig(rig).fingers}))


def check_options(options: ImportOptions, *, several: bool = False) -> None:
    """Raises InputError for what is outside its limits, and for a name of `several` files."""
    if several and options.name is not None:
        raise InputError("--name is for one file; objects of several are named after their files")
    limits = (
        ("--tolerance", options.tolerance_mm, _LEAST_TOLERANCE_MM, _MOST_TOLERANCE_MM, " mm"),
        ("--deviation", options.deviation_mm, 0.0, _MOST_TOLERANCE_MM, " mm"),
        ("--thickness", options.thickness_mm, _LEAST_TOLERANCE_MM, _MOST_THICKNESS_MM, " mm"),
        ("--least-probability", options.least_probability, 0.0, 1.0, ""),
    )
    for option, value, least, most, unit in limits:
        if value is not None and not least <= value <= most:
            raise InputError(f"{option} is {value:g}{unit}; it must be from {least:g} to {most:g}{unit}")
    if options.name is not None and (not options.name.isprintable() or options.name.strip() != options.name):
        raise InputError("--name must be printable characters without blanks around them")
    if options.name is not None and not 0 < len(options.name) <= 90:
        raise InputError(f"--name has {len(options.name)} characters; it must have from 1 to 90")


def load_target(target: Path, *, add: bool, again: bool = False) -> ObjectsFileText | None:
    """What the objects file holds already; InputError, before anything is computed, if it stays as it is.

    `again`: one that was made by imports alone is brought up to date.
    """
    check_place(target)
    if not target.exists():
        return None
    refused = f"{target} is there already: add to it with --add, or choose another with --out"
    if not add and not again:
        raise InputError(refused)
    load_objects(target)
    there = load_objects_text(target)
    if not add and any(item.source is None for item in there.objects):
        raise InputError(f"{refused}; it holds objects that were not imported")
    return there
