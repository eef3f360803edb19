"""File of a study's runs, JSON Lines: its first line says what decides them, each other one is a run."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from palpate.base.errors import InputError, OutputError
from palpate.base.files import read_bytes
from palpate.base.files.code_digest import source_digest
from palpate.base.files.limits import RUNS_BYTES
from palpate.config.problems import shown
from palpate.config.study_result import StudyRunOut
from palpate.config.writers import file_text
from palpate.rig.study.simulation import Simulation

__all__ = ["DECIDING_CODE", "RunsFile"]

DECIDING_CODE = (
    "palpate.recognizer",
    "palpate.base.geometry",
    "palpate.drivers",
    "palpate.config",
    "palpate.rig",
)
"""Packages on whose code it depends what becomes of a run."""

_FORMAT = "palpate/study-runs@1"


class RunsFile:
    """Runs of one study, read and added to. A last line that was cut off is done away with, and done again.

    `study`: the digest of all that decides them.
    """

    def __init__(self, path: Path, simulation: Simulation) -> None:
        """Read what is there. Raises InputError for a file that cannot be read, or is of another study."""
        self._path = path
        self._head = _deciding(simulation)
        self.study = _digest(json.dumps(self._head))
        self.runs: list[StudyRunOut] = []
        if path.exists():
            self.runs = list(self._read())
        else:
            self._write(_lines([self._head]), "xb")

    def add(self, runs: Sequence[StudyRunOut]) -> None:
        """Keep runs. Raises OutputError if they cannot be written."""
        self._write(_lines([run.model_dump(mode="json") for run in runs]), "ab")

    def _read(self) -> Iterator[StudyRunOut]:
        data, head = read_bytes(self._path, RUNS_BYTES, "study fewer runs"), _lines([self._head])
        if len(data) < len(head) and head.startswith(data):  # empty, or it ended while that was written
            self._write(head[len(data) :], "ab")
            return
        first, *lines = data[: data.rfind(b"\n") + 1].splitlines() or [data]
        self._check_head(first)
        for number, line in enumerate(lines, 2):
            try:
                yield StudyRunOut.model_validate_json(line)
            except ValidationError:
                raise InputError(
                    f"{self._path}: line {number} is damaged; delete that line, and its run is done again"
                ) from None
        if not data.endswith(b"\n"):
            self._cut_to(data.rfind(b"\n") + 1)

    def _check_head(self, line: bytes) -> None:
        try:
            found = json.loads(line)
        except ValueError:
            found = None
        if not isinstance(found, dict) or found.get("format") != _FORMAT:
            raise InputError(
                f"{self._path}: is not a file of runs: its first line is "
                f"{shown(line.decode(errors='replace'))}; choose another file"
            )
        if found != self._head:
            raise InputError(
                f"{self._path}: holds runs of another study ({_difference(found, self._head)}); "
                "choose another file"
            )

    def _write(self, data: bytes, mode: str) -> None:
        try:
            with self._path.open(mode) as file:
                file.write(data)
        except OSError as error:
            raise self._unwritten(error) from error

    def _cut_to(self, size: int) -> None:
        try:
            os.truncate(self._path, size)
        except OSError as error:
            raise self._unwritten(error) from error

    def _unwritten(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path} cannot be written: {error.strerror}")


def _lines(values: Sequence[object]) -> bytes:
    return "".join(json.dumps(value, separators=(",", ":")) + "\n" for value in values).encode()


def _deciding(simulation: Simulation) -> dict[str, Any]:
    """All that decides the runs, each by itself, so that it can be said what is another."""
    return {
        "format": _FORMAT,
        "palpate": version("palpate"),
        "code": source_digest(*DECIDING_CODE, compiled=True),
        "rig": _digest(simulation.rig.model_dump_json()),
        "objects": _digest(file_text(simulation.objects)),
        "strategy": simulation.strategy.value,
        "seed": simulation.seed,
        "placed_within_mm": simulation.within_mm,
    }


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _difference(found: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    """What of a file's first line is not this study's; the code only if nothing else is."""
    other = [key for key in own if found.get(key) != own[key]]
    if found.keys() != own.keys() or other == ["code"]:
        return "by code of palpate that has been upgraded or changed since"
    words = {
        "palpate": f"by palpate {shown(found['palpate'])[1:-1]}",
        "rig": "another rig",
        "objects": "other objects",
        "strategy": f"strategy {shown(found['strategy'])[1:-1]}",
        "seed": f"seed {shown(found['seed'])}",
        "placed_within_mm": f"parts placed within {shown(found['placed_within_mm'])} mm",
    }
    return ", ".join(words[key] for key in other if key in words)
