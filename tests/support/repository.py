"""Folders of the repository that holds the tests."""

from pathlib import Path

__all__ = ["EXAMPLES", "PACKAGE", "ROOT"]

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
PACKAGE = ROOT / "src" / "palpate"
