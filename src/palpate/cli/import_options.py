"""Options of an import by file: what the command line says, and what the settings of a folder do."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Self

from palpate.base.errors import InputError
from palpate.base.file_access import relative_path
from palpate.base.file_io import write_text
from palpate.config.import_settings import SETTINGS_FILE, ImportSettings, load_import_settings
from palpate.rig.catalogue.cad_import import ImportOptions
from palpate.rig.catalogue.folder_import import FoundFiles, some_of
from palpate.rig.catalogue.import_states import Height


@dataclass(frozen=True)
class SettingsOfFiles:
    """Import settings, if there are any, of files as seen from the folder that they are in."""

    settings: ImportSettings | None
    folder: Path

    @classmethod
    def load(cls, path: Path, file: Path | None) -> Self:
        """The settings in `file`, or those of the folder `path`, or which it is in. Raises InputError."""
        own = (path if path.is_dir() else path.parent) / SETTINGS_FILE
        if file is None and own.is_file():
            file = own
        return cls(
            None if file is None else load_import_settings(file), Path() if file is None else file.parent
        )

    def of(self, path: Path) -> dict[str, object]:
        """What is said of a file."""
        return {} if self.settings is None else self.settings.of(self._seen(path))

    def unused(self, paths: Sequence[Path]) -> tuple[str, ...]:
        """Patterns that no file matches."""
        return () if self.settings is None else self.settings.unused(map(self._seen, paths))

    def _seen(self, path: Path) -> PurePosixPath:
        return PurePosixPath(relative_path(path, self.folder))


@dataclass(frozen=True)
class RequestedOptions:
    """Options of files: what a command line has `said`, before the `settings`; heights are those of a rig."""

    said: Mapping[str, object]
    heights_mm: tuple[Height, ...] | None
    settings: SettingsOfFiles

    def of(self, path: Path | None) -> ImportOptions:
        """Options of a file; None: what the command line says of all."""
        known = dict(self.said) if path is None else self.settings.of(path) | dict(self.said)
        return ImportOptions.of(known, self.heights_mm)

    def select(self, found: FoundFiles) -> FoundFiles:
        """The files but for those that settings leave out, and what to say of settings. Raises InputError."""
        out = [path for path in found.paths if self.settings.of(path).get("leave_out")]
        lines = [f"left out by settings: {some_of([str(path) for path in out])}"] if out else []
        unused = self.settings.unused(found.paths) if len(found.paths) > 1 else ()
        if unused:
            lines.append(f"settings match no file: {some_of(list(unused))}")
        left = tuple(path for path in found.paths if path not in out)
        if not left:
            raise InputError("settings leave out all files")
        return FoundFiles(left, (*found.left_out, *lines))


def write_settings_template(folder: Path, files: Sequence[Path]) -> Path:
    """Write settings of a folder with a table for each kind of file, to be filled in. Raises InputError."""
    place = folder / SETTINGS_FILE
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder: settings are written into the folder that is imported")
    if place.exists():
        raise InputError(f"{place} is there already; edit it")
    kinds = dict.fromkeys(f"*{path.suffix}" for path in files)
    tables = "".join(f"\n[files.{json.dumps(kind)}]\n{_hint(kind)}" for kind in kinds)
    write_text(place, _SETTINGS_HEAD + tables)
    return place


def _hint(kind: str) -> str:
    """Lines for files of a kind: what they need, as comments."""
    suffix = kind[1:].lower()
    if suffix in (".stl", ".obj", ".ply"):
        return '# units = "mm"  # these files have none: mm, inch or m\n'
    if suffix in (".dxf", ".svg"):
        return "# thickness_mm = 10.0  # height of the parts that these drawings show\n"
    return ""


_SETTINGS_HEAD = """\
# Settings of `palpate objects import` for this folder; docs/importing.md lists all of them.
format = "palpate/import-settings@1"
# tolerance_mm = 0.1
# density_g_cm3 = 1.24  # of PLA; with friction it says which force the parts hold
# friction = 0.3

# Files by pattern; later tables go before earlier ones. Also: name, tags, states, up, leave_out.
"""
