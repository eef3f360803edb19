"""Public CAD files by a fixed seed: draw them from clones of Git repositories, or take them out of these.

    python benchmarks/draw_public_files.py draw owner/name=CLONE… > benchmarks/public-files.csv
    python benchmarks/draw_public_files.py take benchmarks/public-files.csv --from CLONES --into FOLDER

`draw` writes, for each project and format, at most so many files of its newest commit, no content twice,
without what Git LFS keeps and what a program drew of source code (`docs/` of doxygen). `take` looks for each
file by its content, so that no other version can be judged by mistake. The files themselves are not kept
here: each has its own licence.
"""

import argparse
import csv
import random
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

SEED = 1
MOST = {"step": 14, "stl": 10, "3mf": 6, "obj": 6, "ply": 6, "dxf": 12, "svg": 4}
"""Files of one project, by format."""
_ALIASES = {"stp": "step"}
_LFS = b"version https://git-lfs"


class Source(NamedTuple):
    """A file of a project: where it is, and the id that Git gives its content."""

    repository: str
    commit: str
    blob: str
    path: str

    @property
    def format(self) -> str:
        """The format by the file's name."""
        suffix = PurePosixPath(self.path).suffix.lower().removeprefix(".")
        return _ALIASES.get(suffix, suffix)

    @property
    def name(self) -> str:
        """A name for the file that tells the project, and is no other file's."""
        path = PurePosixPath(self.path)
        return (
            f"{self.repository.split('/')[1]}--{self.blob[:8]}--{path.stem.replace(' ', '_')}.{self.format}"
        )


def git(clone: Path, *arguments: str) -> bytes:
    """What Git prints."""
    return subprocess.run(["git", "-C", str(clone), *arguments], capture_output=True, check=True).stdout


def sources(clone: Path, repository: str) -> Iterator[Source]:
    """All CAD files of the newest commit whose content is there."""
    commit = git(clone, "rev-parse", "HEAD").decode().strip()
    for line in git(clone, "ls-tree", "-r", "-z", "HEAD").decode().split("\0")[:-1]:
        about, path = line.split("\t")
        source = Source(repository, commit, about.split()[2], path)
        if source.format in MOST and "-master/docs/" not in path and _is_there(clone, source):
            yield source


def _is_there(clone: Path, source: Source) -> bool:
    try:
        return not git(clone, "cat-file", "blob", source.blob).startswith(_LFS)
    except subprocess.CalledProcessError:
        return False


def draw(clones: list[str]) -> list[Source]:
    """Files of all clones, `owner/name=FOLDER`, in the order of their projects' and own names."""
    rng, seen, drawn = random.Random(SEED), set[str](), list[Source]()
    for repository, _, clone in sorted(item.partition("=") for item in clones):
        found = defaultdict[str, list[Source]](list)
        for source in sorted(sources(Path(clone), repository), key=lambda item: item.path):
            if source.blob not in seen:
                seen.add(source.blob)
                found[source.format].append(source)
        for suffix, most in MOST.items():
            drawn += rng.sample(found[suffix], min(most, len(found[suffix])))
    return drawn


def take(listed: list[Source], clones: Path, into: Path) -> None:
    """Write the files; each clone is in a folder with the repository's name, or `owner+name`."""
    into.mkdir(parents=True, exist_ok=True)
    for source in listed:
        names = (source.repository.split("/")[1], source.repository.replace("/", "+"))
        clone = next(
            path for name in names for path in (clones / name / "repo", clones / name) if path.is_dir()
        )
        (into / source.name).write_bytes(git(clone, "cat-file", "blob", source.blob))


def read_list(path: Path) -> list[Source]:
    """What `draw` wrote."""
    with path.open(newline="") as file:
        return [Source(**row) for row in csv.DictReader(file)]


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    drawing = commands.add_parser("draw")
    drawing.add_argument("clones", nargs="+", metavar="OWNER/NAME=CLONE")
    taking = commands.add_parser("take")
    taking.add_argument("list", type=Path)
    taking.add_argument("--from", dest="clones", type=Path, required=True)
    taking.add_argument("--into", type=Path, required=True)
    asked = parser.parse_args()
    if asked.command == "draw":
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(Source._fields)
        writer.writerows(draw(asked.clones))
    else:
        take(read_list(asked.list), asked.clones, asked.into)


if __name__ == "__main__":
    main()
