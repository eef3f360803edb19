"""Whatever a file holds: it is read, or refused with one `InputError` line. Never anything else."""

import copy
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st
from repository import EXAMPLES

from palpate.base.errors import InputError
from palpate.config import load_contacts, load_objects, load_rig, load_scene, shipped_objects, shipped_rig

QUICK = settings(max_examples=120, deadline=None, derandomize=True)

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(min_value=-(10**30), max_value=10**30),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["mm", "palpate/rig@1", "f1", "mock://bus", 10**400, -0.0, 1e308, 5e-324]),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=8,
)


def accepted_or_refused(load: Callable[[Path], object], raw: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "input"
        file.write_bytes(raw)
        try:
            load(file)
        except InputError as error:
            message = str(error)
            assert message.startswith(f"{file}: ")
            assert len(message.splitlines()) == 1
            assert "pydantic" not in message
            assert "://errors" not in message


def mutated(data: st.DataObject, document: Any) -> Any:
    """`document` with one random node replaced, left out, renamed or repeated."""
    document = copy.deepcopy(document)
    node = document
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return document
        key = data.draw(st.sampled_from(keys))
        deeper = isinstance(node[key], dict | list)
        if not deeper or data.draw(st.integers(0, 3)) == 0:
            break
        node = node[key]
    action = data.draw(st.sampled_from(["replace", "remove", "repeat"]))
    if action == "replace":
        node[key] = data.draw(values)
    elif action == "remove":
        del node[key]
    elif isinstance(node, dict):
        node[data.draw(st.text(max_size=6))] = node[key]
    else:
        node.append(node[key])
    return document


@pytest.mark.parametrize("load", [load_objects, load_contacts, load_scene, load_rig])
@given(raw=st.binary(max_size=80))
@QUICK
def test_any_bytes(load: Callable[[Path], object], raw: bytes) -> None:
    accepted_or_refused(load, raw)


JSON_FILES = [
    (load_objects, shipped_objects().read_text(encoding="utf-8")),
    (load_contacts, (EXAMPLES / "contacts.json").read_text(encoding="utf-8")),
    (load_scene, (EXAMPLES / "scene.json").read_text(encoding="utf-8")),
]


@pytest.mark.parametrize(("load", "text"), JSON_FILES, ids=["objects", "contacts", "scene"])
@given(data=st.data())
@QUICK
def test_json_files_with_one_thing_changed(
    load: Callable[[Path], object], text: str, data: st.DataObject
) -> None:
    accepted_or_refused(load, json.dumps(mutated(data, json.loads(text))).encode())


@given(data=st.data())
@QUICK
def test_rigs_with_one_thing_changed(data: st.DataObject) -> None:
    document = mutated(data, tomlkit.parse(shipped_rig().read_text(encoding="utf-8")).unwrap())
    try:
        raw = tomlkit.dumps(document).encode()
    except (tomlkit.exceptions.TOMLKitError, TypeError, ValueError):
        return  # TOML cannot say it, null for one
    accepted_or_refused(load_rig, raw)
