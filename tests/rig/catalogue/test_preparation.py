"""Preparation of catalogues: what is kept, processes, interruption."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
import trimesh

from palpate.base.array_cache import Cache, map_arrays, write_arrays
from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.cad.parts import Solid
from palpate.recognizer import Catalogue, Contact, Finger, recognise
from palpate.rig.catalogue.import_states import Shares, import_states
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.workers import in_processes
from support.benches import processes
from support.campaign.objects import placed_anyhow
from support.commands.command import PATIENCE_S
from support.commands.repository import ROOT, SHARED_OUTLINES, needs_shared_outlines
from support.oracles.kernel import FINGERS, bits_of, digest, drawn_catalogue
from support.oracles.shapely_touches import grip, outlines

# ----------------------------------------------------------------------------------------------------
# Prepared catalogues: kept or made, alone or by many at once, the numbers and the answers are the same.

SEED, VERTICES = 11, 2500
_PATHS = (str(ROOT / "tests"), os.environ.get("PYTHONPATH", ""))
_ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, _PATHS))}


@pytest.fixture(scope="module")
def objects() -> list[ObjectModel]:
    return drawn_catalogue(SEED, least_vertices=VERTICES)


@pytest.fixture(scope="module")
def fresh(objects: list[ObjectModel]) -> Catalogue:
    return Catalogue(objects)


@pytest.fixture(scope="module")
def expected(fresh: Catalogue) -> dict[str, bytes]:
    return bits_of(fresh)


def _differing(expected: dict[str, bytes], catalogue: Catalogue) -> list[str]:
    found = bits_of(catalogue)
    return [name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name)]


def _made_nothing(text: str) -> None:
    raise AssertionError(f"nothing was to be prepared: {text}")


def test_what_was_kept_is_what_would_be_made(
    objects: list[ObjectModel], fresh: Catalogue, expected: dict[str, bytes], tmp_path: Path
) -> None:
    cache, said = Cache(tmp_path), []
    assert _differing(expected, prepare_catalogue(objects, FINGERS, said.append, cache)) == []
    assert said[0] == f"preparing outlines: 0 of {len(fresh.states)}"
    kept = prepare_catalogue(objects, FINGERS, _made_nothing, cache)
    assert _differing(expected, kept) == []
    for contacts in _grips(objects, 6):
        one, two = recognise(fresh, contacts), recognise(kept, contacts)
        assert [_told(item) for item in one.hypotheses] == [_told(item) for item in two.hypotheses]


def _grips(objects: Sequence[ObjectModel], count: int) -> list[list[Contact]]:
    rng, found = np.random.default_rng(1), []
    while len(found) < count:
        model = objects[int(rng.integers(len(objects)))]
        if not model.states[0].sections_at(5.0):
            continue
        contacts = grip(placed_anyhow(model, rng), rng, fingers=3, radius=4.0, bound=0.2, half_range=0.2)
        at_height = [
            Contact(
                item.name, Finger(4.0, 5.0), item.touched, item.start_mm, item.end_mm, 0.2, normal=item.normal
            )
            for item in contacts
        ]
        if all(item.touched for item in at_height):
            found.append(at_height)
    return found


def _told(item: object) -> str:
    return repr((item.state.object_name, item.configuration, item.bounds, item.verified))  # type: ignore[attr-defined]


@needs_shared_outlines
def test_cut_parts_come_back_as_they_were_made(tmp_path: Path) -> None:
    models, finger = outlines(SHARED_OUTLINES), (Finger(5.0, 10.0),)
    cache = Cache(tmp_path)
    prepare_catalogue(models, finger, cache=cache)
    kept = prepare_catalogue(models, finger, _made_nothing, cache)
    expected = bits_of(Catalogue(models), finger)
    assert {name for name, value in bits_of(kept, finger).items() if value != expected[name]} == set()


def test_an_object_that_is_added_or_changed_is_prepared_alone(
    objects: list[ObjectModel], expected: dict[str, bytes], tmp_path: Path
) -> None:
    cache, said = Cache(tmp_path), []
    prepare_catalogue([*objects[5:], objects[2]], FINGERS, cache=cache)
    whole = prepare_catalogue(objects, FINGERS, said.append, cache)
    assert _differing(expected, whole) == []
    # Objects 0, 1, 3 and 4 are new, for states and for each finger.
    states = sum(len(objects[number].states) for number in (0, 1, 3, 4))
    assert {int(text.split(" of ")[1].split()[0]) for text in said} <= set(range(1, states + 1))


def test_a_small_catalogue_leaves_no_files(tmp_path: Path, objects: list[ObjectModel]) -> None:
    prepare_catalogue(objects[:2], FINGERS, _made_nothing, Cache(tmp_path))
    assert not list(tmp_path.iterdir())


def test_made_by_several_processes_it_is_the_same(
    objects: list[ObjectModel], expected: dict[str, bytes]
) -> None:
    made = prepare_catalogue(objects, FINGERS, cache=Cache(None), alone_s=0.0)
    assert _differing(expected, made) == []


def test_a_wrong_object_is_refused_as_ever(objects: list[ObjectModel], tmp_path: Path) -> None:
    wrong = [*objects, replace(objects[0], tolerance_mm=-1.0)]
    with pytest.raises(InputError, match="tolerance"):
        prepare_catalogue(wrong, FINGERS, cache=Cache(tmp_path))


@pytest.mark.parametrize("cases", [3, pytest.param(200, marks=pytest.mark.campaign)])
def test_damaged_files_are_made_anew(
    objects: list[ObjectModel], expected: dict[str, bytes], tmp_path: Path, cases: int
) -> None:
    cache, rng = Cache(tmp_path), np.random.default_rng(7)
    prepare_catalogue(objects, FINGERS, cache=cache)
    for _ in range(cases):
        files = sorted(tmp_path.iterdir())
        path = files[int(rng.integers(len(files)))]
        data = bytearray(path.read_bytes())
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        said: list[str] = []
        assert _differing(expected, prepare_catalogue(objects, FINGERS, said.append, cache)) == []
        assert said
    prepare_catalogue(objects, FINGERS, _made_nothing, cache)


def test_sound_files_with_other_contents_are_made_anew(
    objects: list[ObjectModel], expected: dict[str, bytes], tmp_path: Path
) -> None:
    """As by a program that knows the format: digests fit, arrays do not."""
    cache = Cache(tmp_path)
    prepare_catalogue(objects, FINGERS, cache=cache)
    kept = {path: map_arrays(path) for path in sorted(tmp_path.iterdir())}
    for path, arrays in list(kept.items())[:1]:  # each costs a preparation
        for spoilt in (
            {name: value for name, value in arrays.items() if not name.endswith("first")},
            {name: value[:-1] if value.ndim else value for name, value in arrays.items()},
            arrays | {"digests": arrays["digests"].astype(np.float64)},
            {name: value for name, value in arrays.items() if name != "digests"},
            {},
        ):
            for other in tmp_path.iterdir():
                other.unlink()
            write_arrays(path, spoilt)
            assert _differing(expected, prepare_catalogue(objects, FINGERS, cache=cache)) == []


def _start(folder: Path, task: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "support.oracles.kernel", str(folder), str(SEED), task],
        stdout=subprocess.PIPE,
        text=True,
        env=_ENVIRONMENT,
    )


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(8, marks=pytest.mark.campaign)])
def test_processes_that_start_at_once_agree(fresh: Catalogue, tmp_path: Path, count: int) -> None:
    running = [_start(tmp_path, "once") for _ in range(count)]
    answers = {process.communicate(timeout=PATIENCE_S)[0].strip() for process in running}
    assert answers == {digest(fresh)}
    assert [path.suffix for path in tmp_path.iterdir()] == [".arrays"] * 3


@pytest.mark.slow
@pytest.mark.parametrize("kills", [1, pytest.param(50, marks=pytest.mark.campaign)])
def test_a_start_after_a_kill_gives_the_same_answer(
    objects: list[ObjectModel], expected: dict[str, bytes], tmp_path: Path, kills: int
) -> None:
    """Killed while it writes, over and over: at random moments of that."""
    rng = np.random.default_rng(3)
    for _ in range(kills):
        process = _start(tmp_path, "keep")
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(float(rng.uniform(0, 0.05)))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert _differing(expected, prepare_catalogue(objects, FINGERS, cache=Cache(tmp_path))) == []


# ----------------------------------------------------------------------------------------------------
# Parallel processes: none outlives what began it, and no more are started than are wanted.


def test_processes_end_with_one_that_is_killed(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "support.benches.processes", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, env=_ENVIRONMENT) as process:
        # Begun, not processes: the one with short work may take the next before the third is awake.
        while len(list(tmp_path.iterdir())) < 3:
            assert process.poll() is None
            time.sleep(0.05)
        process.kill()
        # Ends when the last process that holds it does: one with work, and one that waits for some.
        assert process.communicate(timeout=PATIENCE_S)[0] == b""


def test_no_more_processes_than_workers(tmp_path: Path) -> None:
    found = in_processes(processes.wait, [(str(tmp_path), 0.0)] * 5, workers=1)
    assert sorted(index for index, _ in found) == list(range(5))
    assert len({path.name.split()[0] for path in tmp_path.iterdir()}) == 1


def test_a_process_that_the_system_ends_is_said() -> None:
    with pytest.raises(InputError, match="was ended from outside, as it is without memory enough"):
        list(in_processes(processes.killed, [()], workers=1))


# ----------------------------------------------------------------------------------------------------
# States that are sectioned in processes of their own.

SHARES = Shares(0.02, 0.001, None, 0.0, as_is=False)  # sections so fine that they take seconds


@pytest.fixture
def alarm_interrupts() -> Iterator[None]:
    """SIGALRM acts as Ctrl-C does."""
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def states_sectioned(solid: Solid, interrupt_after_s: float) -> int:
    """How many states are said to be sectioned; interrupted after a while unless that is 0."""
    told: list[str] = []

    def report(what: str) -> None:
        if what.startswith("sections"):
            if not told:
                signal.setitimer(signal.ITIMER_REAL, interrupt_after_s)
            told.append(what)

    if interrupt_after_s:
        with pytest.raises(KeyboardInterrupt):
            import_states(solid, SHARES, report)
    else:
        import_states(solid, SHARES, report)
    return len(told)


@pytest.mark.usefixtures("alarm_interrupts")
def test_interrupted_it_does_not_wait_for_states_that_were_begun() -> None:
    mesh = trimesh.creation.cone(20.0, 40.0, sections=16)
    solid = Solid("cone", np.asarray(mesh.vertices), np.asarray(mesh.faces))
    others = set(active_children())
    assert states_sectioned(solid, 0.2) < states_sectioned(solid, 0.0) / 2
    assert set(active_children()) <= others
