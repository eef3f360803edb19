"""The device in docs/adding-a-device.md does what every driver has to, as it stands there."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from array_contract import CHECKS, Held

PAGE = Path(__file__).resolve().parents[2] / "docs" / "adding-a-device.md"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """What the programs on the page define."""
    names: dict[str, Any] = {}
    for program in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(program, str(PAGE), "exec"), names)
    return names


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_driver_does_what_every_driver_does(page: dict[str, Any], check: Callable[[Held], None]) -> None:
    check(Held(page["EmulatedLines"], page["LineArray"]))


def test_the_codec_keeps_its_promise(page: dict[str, Any]) -> None:
    encode, rng = page["encode"], np.random.default_rng(4)
    texts = [f"f{k:08x}" + "0ff" * 35 for k in range(200)]
    parts = []
    for text in texts:
        parts += [rng.bytes(int(rng.integers(0, 50))).replace(b"\n", b" ") + b"\n", encode(text)]
    data = b"".join(parts)
    for step in (1, 7, 1000, len(data)):
        decoder = page["LineDecoder"]()
        found = [text for at in range(0, len(data), step) for text in decoder.feed(data[at : at + step])]
        assert found == texts
        assert decoder.faults == {"damaged line": 200}
    for _ in range(100):
        assert decoder.feed(b"x" * 5000) == []
        assert decoder.waiting <= page["LONGEST"]
    assert decoder.feed(b"\n" + encode("still here")) == ["still here"]


def test_links_and_names_on_the_page_lead_somewhere() -> None:
    text = PAGE.read_text(encoding="utf-8")
    root = PAGE.parents[1]
    for name in re.findall(r"`((?:drivers|config|docs|rig|tests)/[\w/.-]+)`", text):
        assert (root / name).exists(), name
    for link in re.findall(r"\]\(([^)]+)\)", text):
        assert (PAGE.parent / link).exists(), link
