"""A folder that looks like installed distributions with entry points, for the front of `sys.path`."""

from pathlib import Path

__all__ = ["install"]


def install(folder: Path, name: str, group: str, entries: dict[str, str]) -> None:
    """Write the metadata of distribution `name`, version 1.0, that registers `entries` in `group`."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
