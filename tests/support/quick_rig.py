"""A rig file for tests of whole commands: the shipped rig with two fingers and short ways, so faster."""

from pathlib import Path

from palpate.config import shipped_rig


def quick_rig(path: Path, max_grips: int = 8) -> Path:
    """Write it to `path`, and return that."""
    text = shipped_rig().read_text(encoding="utf-8")
    for old, new in (
        ("radius_mm = 125.0", "radius_mm = 60.0"),
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 30.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 125.0"),
        ("max_grips = 8", f"max_grips = {max_grips}"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text[: text.rindex("[[fingers]]")], encoding="utf-8")
    return path
