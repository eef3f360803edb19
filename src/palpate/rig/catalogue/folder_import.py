"""Import of a folder of CAD files into a catalogue: one process per file, and only for changed files.

The source of an object is stored with it (`source`): the file, a hash of its content, and one of the
options. An object whose file and options are unchanged is kept, and so is the reason why a file was refused.
A file that fails does not affect the others.
"""

import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from palpate.base.confined_reading import UnfinishedReadingError
from palpate.base.errors import InputError, MissingPackageError, PalpateError
from palpate.base.file_access import relative_path
from palpate.base.file_io import CAD_BYTES, read_bytes
from palpate.cad.parts import GIVE_NO_UNITS
from palpate.cad.readers import CAD_SUFFIXES, is_drawing
from palpate.config.objects_tables import ObjectsFileText, ObjectText, RefusedText, SourceText
from palpate.rig.catalogue.cad_import import Imported, ImportedObject, ImportOptions, LossError, import_file
from palpate.rig.workers import in_processes

Report = Callable[[str], None]

OptionsOf = Callable[[Path], ImportOptions]
"""Options of each file."""

_ADVICE = "divide it"
_REQUEST_EDITION = (
    3  # to be raised when the same file becomes another object: what was kept is then read again
)


@dataclass(frozen=True)
class FileOutcome:
    """Outcome of a file: new objects, or the names of those that are kept; or why there are none.

    `refused`: parts of it that are no objects, and why, a line each. `unchanged`: it was not read again.
    `is_loss`: it can be read, but too much would be left out. `is_final`: it fails until it has changed.
    """

    path: Path
    objects: tuple[ImportedObject, ...] = ()
    kept: tuple[str, ...] = ()
    unchanged: bool = False
    warnings: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    failure: str | None = None
    is_loss: bool = False
    is_final: bool = False
    seconds: float = 0.0


@dataclass(frozen=True)
class Catalogued:
    """The catalogue's new text; what became of each file; kept objects whose files are gone, by file."""

    text: ObjectsFileText
    files: tuple[FileOutcome, ...]
    gone: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class FoundFiles:
    """CAD files, each once, in order; `left_out`: what is not read of folders, and why, a line each."""

    paths: tuple[Path, ...]
    left_out: tuple[str, ...] = ()


_BY_PREFERENCE = (".step", ".stp", ".3mf", ".stl", ".obj", ".ply", ".dxf", ".svg")
"""Of one part in several formats: first what has curves, then what has units, then what is most common."""

_PICTURE = re.compile(r"\.objects(-\d+)?\.svg$")
"""Name of what `palpate objects show` draws by default."""

_MOST_NAMED = 8  # files or folders in a line


def files_in(paths: Sequence[Path], *, recursive: bool = False) -> FoundFiles:
    """All CAD files among paths and in folders; if `recursive`, in theirs as well, but for hidden ones.

    Of files of one folder that have one name but for the suffix, one is taken. Raises InputError for a folder
    without any CAD file.
    """
    found: dict[Path, None] = {}
    lines: list[str] = []
    for path in paths:
        if not path.is_dir():
            found[path] = None
            continue
        inside, others = _inside(path, recursive=recursive)
        if not inside:
            more = f"; {others[0]}" if others else ""
            raise InputError(f"{path}: holds no CAD file ({', '.join(sorted(CAD_SUFFIXES))}){more}")
        found |= dict.fromkeys(inside)
        lines += others
    best: dict[Path, Path] = {}
    for path in sorted(found, key=_preference):
        best.setdefault(path.with_suffix(""), path)
    kept = {*best.values()}
    twins = [
        f"{path} ({best[path.with_suffix('')].name} is there, too)" for path in found if path not in kept
    ]
    if twins:
        lines.append(f"not read: {some_of(twins)}; to read one of these, give it by itself")
    return FoundFiles(tuple(path for path in found if path in kept), tuple(lines))


def _inside(folder: Path, *, recursive: bool) -> tuple[list[Path], list[str]]:
    """CAD files of a folder, in order, and what is left out of it."""
    files: list[Path] = []
    pictures: list[Path] = []
    passed, hidden = [], []
    for root, folders, names in os.walk(folder):
        here = Path(root)
        for name in names:
            if Path(name).suffix.lower() in CAD_SUFFIXES:
                (pictures if _PICTURE.search(name) else files).append(here / name)
        folders.sort()
        secret = [name for name in folders if name.startswith((".", "__"))]
        hidden += [str(here / name) for name in secret]
        folders[:] = [name for name in folders if name not in secret]
        if not recursive:
            passed += [str(here / name) for name in folders if _holds_cad_files(here / name)]
            break
    lines = [f"folders that were not entered, as it is not recursive: {some_of(passed)}"] if passed else []
    if pictures:
        lines.append(f"pictures of objects show: {some_of(sorted(map(str, pictures)))}")
    return sorted(files), [*lines, *([f"hidden: {some_of(hidden)}"] if hidden and recursive else [])]


def _preference(path: Path) -> int:
    """Rank of a file's format; an unknown one is refused later, by its own name."""
    suffix = path.suffix.lower()
    return _BY_PREFERENCE.index(suffix) if suffix in _BY_PREFERENCE else -1


def _holds_cad_files(folder: Path) -> bool:
    return any(Path(name).suffix.lower() in CAD_SUFFIXES for _, _, names in os.walk(folder) for name in names)


def some_of(items: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    more = len(items) - _MOST_NAMED
    return ", ".join(items[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _source_of(path: Path, options: ImportOptions, target: Path) -> SourceText:
    """Source of an object of a file, as the objects file `target` has it. Raises InputError."""
    content = hashlib.sha256(read_bytes(path, CAD_BYTES, _ADVICE)).hexdigest()
    asked = json.dumps([_REQUEST_EDITION, asdict(options)], sort_keys=True)
    return SourceText(
        file=relative_path(path, target.parent),
        sha256=content,
        request=hashlib.sha256(asked.encode()).hexdigest()[:16],
    )


def import_files(
    paths: Sequence[Path],
    options: OptionsOf,
    target: Path,
    there: ObjectsFileText | None,
    report: Report = lambda _: None,
    *,
    keep: Callable[[ObjectsFileText], None] = lambda _: None,
    several: bool = True,
) -> Catalogued:
    """Import files into the text of an objects file, `there`, that is to be written to `target`.

    `options` of each file; units are for files that state none. Nothing that came from another file is
    replaced: an object whose name is taken gets its file's name, or a number. `keep` is given what is done so
    far after every file, as long as there are objects. One that is not among `several` raises InputError
    where it fails, and is read in any case.
    """
    before = there or _text([], [])
    if not several:
        return _one(paths[0], options(paths[0]), target, before, report)
    sources, outcomes = _sources(paths, options, target)
    outcomes |= {path: found for path, source in sources.items() if (found := _known(before, path, source))}
    changed = [path for path in paths if path not in outcomes]
    text = before
    for path, outcome in _import_all(changed, options, report):
        outcomes[path] = outcome
        text, _ = _with_all(before, paths, outcomes, sources)
        if text.objects:
            keep(text)
    text, named = _with_all(before, paths, outcomes, sources)
    gone = tuple(
        (item.name, item.source.file)
        for item in text.objects
        if item.source is not None and not (target.parent / item.source.file).exists()
    )
    return Catalogued(text, named, gone)


def _one(
    path: Path, options: ImportOptions, target: Path, before: ObjectsFileText, report: Report
) -> Catalogued:
    """A file by itself: its states are what is done in parallel."""
    source = _source_of(path, options, target)
    try:
        found = import_file(path, options, report)
    except LossError as error:
        return Catalogued(before, (FileOutcome(path, failure=str(error), is_loss=True),), ())
    objects, named = _exchange_objects(before.objects, found.objects, source, path.stem, whole=False)
    outcome = FileOutcome(path, named, warnings=found.warnings, refused=found.refused)
    others = [item for item in before.refused or [] if item.source.file != source.file]
    return Catalogued(_text(objects, [*others, *_refused_parts(outcome, source)]), (outcome,), ())


def _refused_parts(outcome: FileOutcome, source: SourceText) -> list[RefusedText]:
    """What is kept of the parts of a file that are refused."""
    return [RefusedText(source=source, why=why, is_loss=False) for why in outcome.refused]


def _text(objects: Sequence[ObjectText], refused: Sequence[RefusedText]) -> ObjectsFileText:
    """The text of a file, which may hold no object yet."""
    text = ObjectsFileText.model_construct(format="palpate/objects@1", units="mm", objects=list(objects))
    return text.model_copy(update={"refused": list(refused)}) if refused else text


def _with_all(
    before: ObjectsFileText,
    paths: Sequence[Path],
    outcomes: Mapping[Path, FileOutcome],
    sources: Mapping[Path, SourceText],
) -> tuple[ObjectsFileText, tuple[FileOutcome, ...]]:
    """The text with what became of files, in their order whichever was done first; and files, renamed."""
    objects: Sequence[ObjectText] = before.objects
    read = {sources[path].file for path in outcomes if path in sources}
    refused = [item for item in before.refused or [] if item.source.file not in read]
    named = []
    for path in paths:
        outcome = outcomes.get(path)
        if outcome is None:
            continue
        if outcome.objects:
            objects, new = _exchange_objects(objects, outcome.objects, sources[path], path.stem)
            outcome = replace(outcome, objects=new)
        if outcome.objects or outcome.kept:
            refused += _refused_parts(outcome, sources[path])
        elif outcome.is_final:
            why = (outcome.failure or "").removeprefix(f"{path}: ")
            refused.append(RefusedText(source=sources[path], why=why, is_loss=outcome.is_loss))
        named.append(outcome)
    return _text(objects, refused), tuple(named)


def _sources(
    paths: Sequence[Path], options: OptionsOf, target: Path
) -> tuple[dict[Path, SourceText], dict[Path, FileOutcome]]:
    """The sources of files that can be read, and the outcomes of those that cannot."""
    sources, failed = {}, {}
    for path in paths:
        try:
            is_drawing(path)
            sources[path] = _source_of(path, options(path), target)
        except InputError as error:
            failed[path] = FileOutcome(path, failure=str(error))
    return sources, failed


def _known(there: ObjectsFileText, path: Path, source: SourceText) -> FileOutcome | None:
    """Outcome of a file of the same content that was read in the same way, if it was."""
    some = list(_from(there.objects, source.file))
    if some and all(item.source == source for item in some):
        refused = tuple(item.why for item in there.refused or [] if item.source == source)
        return FileOutcome(path, kept=tuple(item.name for item in some), unchanged=True, refused=refused)
    for item in there.refused or []:
        if item.source == source:
            failure = f"{path}: {item.why}"
            return FileOutcome(path, failure=failure, unchanged=True, is_loss=item.is_loss, is_final=True)
    return None


def _from(objects: Sequence[ObjectText], file: str) -> Iterator[ObjectText]:
    return (item for item in objects if item.source is not None and item.source.file == file)


def _exchange_objects(
    objects: Sequence[ObjectText],
    new: Sequence[ImportedObject],
    source: SourceText,
    stem: str,
    *,
    whole: bool = True,
) -> tuple[list[ObjectText], tuple[ImportedObject, ...]]:
    """The objects with the new ones in the place of those of their file, named apart from all others.

    Unless the `whole` file is exchanged, objects of other names stay.
    """
    names = {item.text.name for item in new}
    old = [item for item in _from(objects, source.file) if whole or item.name in names]
    replaced_ones = {id(item) for item in old}
    others = [item for item in objects if id(item) not in replaced_ones]
    place = next((k for k, item in enumerate(objects) if id(item) in replaced_ones), len(others))
    taken = {item.name for item in others}
    named = []
    for item in new:
        renamed = (
            whole and len(old) == len(new) == 1
        )  # the one object of a file keeps a name that it was given
        name = old[0].name if renamed else _free_name(item.text.name, stem, taken)
        taken.add(name)
        replaced = any(before.name == name for before in old)
        text = item.text.model_copy(update={"name": name, "source": source})
        result = item.result.model_copy(update={"name": name, "replaced": replaced})
        named.append(ImportedObject(text, result))
    return [*others[:place], *(item.text for item in named), *others[place:]], tuple(named)


def _free_name(name: str, stem: str, taken: set[str]) -> str:
    """A name that no other object has: its own, its file's, or that with a number."""
    for wanted in (name, stem):
        if wanted not in taken:
            return wanted
    number = 2
    while f"{stem}-{number}" in taken:
        number += 1
    return f"{stem}-{number}"


def _import_all(
    paths: Sequence[Path], options: OptionsOf, report: Report
) -> Iterator[tuple[Path, FileOutcome]]:
    """Every file in a process of its own, as many at once as there are cores, as they come."""
    if not paths:
        return
    report(f"0 of {len(paths)} files")
    work = in_processes(_import_one, [(path, _for_file(path, options(path))) for path in paths])
    for done, (index, outcome) in enumerate(work, 1):
        report(f"{done} of {len(paths)} files")
        yield paths[index], outcome


def _for_file(path: Path, options: ImportOptions) -> ImportOptions:
    """The options that concern a file: a thickness is for drawings only, layers are for DXF files."""
    if not is_drawing(path):
        return replace(options, thickness_mm=None, layers=())
    return options if path.suffix.lower() == ".dxf" else replace(options, layers=())


def _import_one(path: Path, options: ImportOptions) -> FileOutcome:
    """One file; units are those that are asked for only where it states none."""
    begin = time.monotonic()
    try:
        found = _with_own_units(path, options)
    except PalpateError as error:
        return FileOutcome(
            path,
            failure=str(error),
            is_loss=isinstance(error, LossError),
            is_final=isinstance(error, InputError)
            and not isinstance(error, MissingPackageError | UnfinishedReadingError),
            seconds=time.monotonic() - begin,
        )
    except Exception as error:  # a mistake of palpate's own must not cost the other files
        text = f"{path}: cannot be imported, by a mistake in palpate: {type(error).__name__}: {error}"
        return FileOutcome(path, failure=" ".join(text.split()), seconds=time.monotonic() - begin)
    seconds = time.monotonic() - begin
    return FileOutcome(path, found.objects, warnings=found.warnings, refused=found.refused, seconds=seconds)


def _with_own_units(path: Path, options: ImportOptions) -> Imported:
    if options.units is None:
        return import_file(path, options)
    try:
        return import_file(path, options)
    except InputError as error:
        if not str(error).endswith(GIVE_NO_UNITS):
            raise
        return import_file(path, replace(options, units=None))
