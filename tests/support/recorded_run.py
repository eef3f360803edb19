"""A recorded session of two grips on emulated devices."""

import re
from pathlib import Path

from firm_rig import firm_rig

import palpate


def two_grips(folder: Path, seed: int = 7) -> Path:
    """The session's folder, in `folder`."""
    text, number = re.subn(r"max_grips = \d+", "max_grips = 2", firm_rig().read_text(encoding="utf-8"))
    assert number == 1
    (folder / "brief.toml").write_text(text)
    with palpate.open_rig(folder / "brief.toml", seed=seed) as rig:
        rig.identify(sessions=folder / "sessions")
    (found,) = (folder / "sessions").iterdir()
    return found
