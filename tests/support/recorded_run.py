"""A recorded session of two grips on emulated devices."""

import re
from pathlib import Path

from firm_rig import firm_rig

import palpate


def two_grips(folder: Path, seed: int = 7, rig: Path | None = None) -> Path:
    """The session's folder, in `folder`; `rig`: another rig file than the shipped one's."""
    text, number = re.subn(
        r"max_grips = \d+", "max_grips = 2", (rig or firm_rig()).read_text(encoding="utf-8")
    )
    assert number == 1
    (folder / "brief.toml").write_text(text)
    with palpate.open_rig(folder / "brief.toml", seed=seed) as opened:
        opened.identify(sessions=folder / "sessions")
    (found,) = (folder / "sessions").iterdir()
    return found
