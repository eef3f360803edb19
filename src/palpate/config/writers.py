"""Writers of the file formats: values as text that, when read, gives the same values again."""

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Array, InlineTable, Table

from palpate.base.errors import InputError
from palpate.base.file_io import write_text
from palpate.base.geometry.object_model import ObjectModel, Polygon, State
from palpate.config.calibration_file import CalibrationFile, ReferencesFile
from palpate.config.contacts_file import ContactsFile
from palpate.config.diagnosis_results import WiringChangeOut
from palpate.config.emulation import Scene
from palpate.config.fields import FileModel
from palpate.config.loading import Content
from palpate.config.objects_file import ObjectsFile
from palpate.config.objects_tables import ObjectsFileText, objects_json, outline_text
from palpate.config.rig_file import RigFile, load_rig
from palpate.config.wiring_record import ConfirmedWiring, proof_path

_HEAD_COMMENT = (
    "Written by `palpate calibrate`; docs/calibration-file.md explains every key.",
    "It holds for the rig file beside it. Calibrate again rather than edit it.",
)


def calibration_toml(file: CalibrationFile | ConfirmedWiring, comment: Sequence[str] = _HEAD_COMMENT) -> str:
    """The text of a calibration file; `load_calibration` reads the same values from it."""
    document = tomlkit.document()
    for line in comment:
        document.add(tomlkit.comment(line))
    _fill(document, file)
    return tomlkit.dumps(document)


def keep_confirmed(rig: Path, wiring: ConfirmedWiring) -> None:
    """Write confirmed wiring beside a rig file. Raises InputError, OutputError if it cannot be written."""
    comment = (
        "Written by palpate; docs/doctor.md says what it is. Prove the wiring again rather than edit it.",
    )
    write_text(proof_path(rig), calibration_toml(wiring, comment))


def change_rig(path: Path, changes: Iterable[WiringChangeOut]) -> str:
    """Change values in a rig file, and keep all else as it is: comments, order, blanks; returns its text.

    Raises InputError if the file is another by now, would not be right, or is read-only, and writes nothing
    then.
    """
    if not os.access(path, os.W_OK):
        raise InputError(f"{path} is read-only: let it be written (chmod u+w), or change a copy")
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    for change in changes:
        *tables, key = re.findall(r"[a-z_]+|\d+", change.file_key)
        table: Any = document
        for name in tables:
            table = table[int(name) if name.isdecimal() else name]
        table[key] = _plain(change.to)
    text = tomlkit.dumps(document)
    load_rig(Content(str(path), text.encode()))
    write_text(path, text)
    return text


def _plain(value: object) -> object:
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _fill(table: Any, model: FileModel) -> None:
    """Put a model's values into a table: plain ones and lists first, as TOML wants it, then tables."""
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        if value is None or (value == [] and field.default == []):
            continue
        if isinstance(value, FileModel):
            table.add(key, _table(value))
        elif key == "fingers":
            fingers = tomlkit.aot()
            for finger in value:
                fingers.append(_table(finger))
            table.add(key, fingers)
        elif isinstance(value, list):
            table.add(key, _lines(value))
        else:
            table.add(key, list(value) if isinstance(value, tuple) else value)


def _table(model: FileModel) -> Table:
    table = tomlkit.table()
    _fill(table, model)
    return table


def _lines(values: list[Any]) -> Array:
    """One entry a line: rows of a matrix, or small tables."""
    array = tomlkit.array().multiline(True)
    for value in values:
        array.append(_inline(value) if isinstance(value, FileModel) else value)
    return array


def _inline(model: FileModel) -> InlineTable:
    table = tomlkit.inline_table()
    for key in type(model).model_fields:
        table.add(key, getattr(model, key))
    return table


@singledispatch
def file_text(value: object) -> str:
    """Text of the file that holds `value`: JSON or TOML, as its format has it.

    Raises InputError for a value that no file format holds.
    """
    raise InputError(f"a {type(value).__name__} cannot be saved: none of palpate's file formats holds it")


@file_text.register
def _objects(value: ObjectsFile) -> str:
    tables = {"format": "palpate/objects@1", "units": "mm", "objects": objects_values(value.objects)}
    return objects_json(ObjectsFileText.model_validate(tables))


@file_text.register
def _scene(value: Scene) -> str:
    return json.dumps(value.model_dump(mode="json", exclude_defaults=True), indent=1) + "\n"


@file_text.register
def _contacts(value: ContactsFile) -> str:
    return json.dumps(value.model_dump(mode="json", exclude_none=True), indent=1) + "\n"


@file_text.register(RigFile)
@file_text.register(ReferencesFile)
def _tables(value: RigFile | ReferencesFile) -> str:
    return tomlkit.dumps(value.model_dump(mode="json", exclude_unset=True, exclude_none=True))


file_text.register(CalibrationFile)(calibration_toml)


def objects_values(models: Iterable[ObjectModel]) -> list[dict[str, Any]]:
    """Object models as a file's entries."""
    return [_object(item) for item in models]


def _object(model: ObjectModel) -> dict[str, Any]:
    optional = {
        "tolerance": model.tolerance_mm or None,
        "normal_bound": model.normal_bound_rad,
        "least_tip_radius": model.least_tip_radius_mm,
        "part_holds_n": model.holds_n,
        "part_support_mm": model.support_mm,
    }
    return (
        {"name": model.name} | _drop_nulls(optional) | {"states": [_state(state) for state in model.states]}
    )


def _state(state: State) -> dict[str, Any]:
    optional = {
        "probability": state.probability,
        "tipping_angle": state.tipping_angle_rad,
        "height": state.height_mm,
        "heights": state.heights_mm,
        "normal_bound": state.normal_bound_rad,
        "side": [[(x, z) for x, z in ring.tolist()] for ring in state.side_mm] or None,
    }
    sections = [
        {"z": section.z_mm, "polygons": [_polygon(polygon) for polygon in section.polygons]}
        for section in state.sections
    ]
    return {"name": state.name, "sections": sections} | _drop_nulls(optional)


def _polygon(polygon: Polygon) -> dict[str, Any]:
    curves = polygon.curves or (None,) * len(polygon.rings)
    outer, *holes = map(outline_text, polygon.rings, curves)
    return {"outer": outer} | ({"holes": holes} if holes else {})


def _drop_nulls(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}
