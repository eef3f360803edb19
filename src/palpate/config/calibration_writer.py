"""Writer of calibration files: TOML that people can read.

Numbers are as the model holds them: rounded already, bounds upward (`calibration_numbers`).
"""

from typing import Any

import tomlkit
from tomlkit.items import Array, InlineTable, Table

from palpate.config.calibration_file import CalibrationFile
from palpate.config.fields import FileModel

__all__ = ["calibration_toml"]

_HEAD = (
    "Written by `palpate calibrate`; docs/calibration-file.md explains every key.",
    "It holds for the rig file beside it. Calibrate again rather than edit it.",
)


def calibration_toml(file: CalibrationFile) -> str:
    """The text of a calibration file; `load_calibration` reads the same values from it."""
    document = tomlkit.document()
    for line in _HEAD:
        document.add(tomlkit.comment(line))
    _fill(document, file)
    return tomlkit.dumps(document)


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
