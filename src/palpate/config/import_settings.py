"""Settings of the import of a folder's CAD files, `palpate/import-settings@1`, a TOML file.

What stands at the top holds for all files; a table `[files."PATTERN"]` for those whose path from the folder,
or whose name, matches; of several that match, the later one goes before. What a command line says goes before
all.
"""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import PurePosixPath
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from palpate.config.fields import FileModel, Flag, Items, Length, Name, Positive, Text
from palpate.config.loading import Source, load_toml
from palpate.config.problems import problems_of, refuse

SETTINGS_FILE = "palpate-import.toml"
"""Name of the file that the import of a folder looks for in it."""


class Up(StrEnum):
    """Axis of a file that points up, where a part is imported as it lies."""

    PLUS_X = "+x"
    MINUS_X = "-x"
    PLUS_Y = "+y"
    MINUS_Y = "-y"
    PLUS_Z = "+z"
    MINUS_Z = "-z"


class PartSettings(FileModel):
    """Settings of the import of a file; what is left out is as elsewhere."""

    units: Literal["mm", "inch", "m", "pt"] | None = Field(
        default=None, description="Units of files that have none."
    )
    tolerance_mm: Annotated[float, Field(ge=0.001, le=5.0)] | None = Field(
        default=None, description="What approximations may add up to."
    )
    deviation_mm: Annotated[Length, Field(le=5.0)] | None = Field(
        default=None, description="How far the made part may be off the file."
    )
    thickness_mm: Annotated[Positive, Field(le=1000.0)] | None = Field(
        default=None, description="Height of the part that a drawing shows."
    )
    layers: Items[Text] | None = Field(default=None, description="Layers of DXF files that have outlines.")
    parts: Items[Text] | None = Field(default=None, description="Parts of the file, by name or number.")
    name: Name | None = Field(default=None, description="Name of the object.")
    states: Literal["auto", "as-is"] | None = Field(
        default=None, description="All stable states, or only as it lies in the file."
    )
    up: Up | None = Field(default=None, description="Axis of the file that points up; for states as-is.")
    least_probability: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None, description="States that are less probable are left out."
    )
    accept_loss: Flag | None = Field(
        default=None, description="Import it although states that are left out are over 20 % of cases."
    )
    part_holds_n: Positive | None = Field(
        default=None, description="The part does not slide below this horizontal force, N."
    )
    mass_g: Positive | None = Field(default=None, description="Mass, for part_holds_n by friction.")
    density_g_cm3: Positive | None = Field(
        default=None, description="Density, for the mass of a part without mass_g."
    )
    friction: Annotated[Positive, Field(le=2.0)] | None = Field(
        default=None, description="Least coefficient of friction at the table, for part_holds_n."
    )
    tags: Items[Name] | None = Field(default=None, description="Words by which lists choose; as you like.")


class FileSettings(PartSettings):
    """Settings of some files; what is left out is as elsewhere."""

    leave_out: Flag | None = Field(default=None, description="Do not import it.")


class ImportSettings(FileSettings):
    """Settings of a folder; `files`: by pattern, such as "old/*.stl"."""

    format: Literal["palpate/import-settings@1"]
    files: dict[str, FileSettings] = Field(default_factory=dict)

    def of(self, path: PurePosixPath) -> dict[str, object]:
        """Settings of a file, by its path from the folder; only what is said."""
        said = self.model_dump(exclude={"format", "files"}, exclude_none=True)
        for pattern, settings in self.files.items():
            if _matches(path, pattern):
                said |= settings.model_dump(exclude_none=True)
        return said

    def unused(self, paths: Iterable[PurePosixPath]) -> tuple[str, ...]:
        """Patterns that no file matches."""
        there = list(paths)
        return tuple(pattern for pattern in self.files if not any(_matches(path, pattern) for path in there))


def _matches(path: PurePosixPath, pattern: str) -> bool:
    """Whether a pattern is that of a file; a name that is written out matches, whatever brackets it has."""
    return any(text == pattern or fnmatchcase(text, pattern) for text in (str(path), path.name))


def part_settings(said: Mapping[str, object], source: str) -> dict[str, object]:
    """Return settings as they are said in Python, checked as those of a file. Raises InputError."""
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in said.items()}
    try:
        return PartSettings.model_validate(values).model_dump(exclude_none=True)
    except ValidationError as error:
        raise refuse(source, problems_of(error, PartSettings, values, {})) from None


def load_import_settings(source: Source) -> ImportSettings:
    """Read and check import settings. Raises InputError, one line."""
    return load_toml(source, ImportSettings, {})
