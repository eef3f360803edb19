"""The environment, judged by Gymnasium's own checker; Gymnasium is not among palpate's dependencies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from support.benches.rigs import quick_bench
from support.commands.repository import ROOT

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install gymnasium")
pytestmark = pytest.mark.filterwarnings("ignore::palpate.RigWarning")


@pytest.fixture(scope="module")
def env(tmp_path_factory: pytest.TempPathFactory) -> Any:
    import palpate_gymnasium

    rig, objects = quick_bench(tmp_path_factory.mktemp("bench"))
    return gymnasium.make(palpate_gymnasium.ENV_ID, rig=rig, objects=objects)


def test_gymnasium_finds_nothing_wrong(env: Any) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(env.unwrapped)


def test_an_episode_ends_with_the_part_inside_the_bounds(env: Any, tmp_path: Path) -> None:
    """A part whose place is known, touched as palpate's planner says; the last observation tells it."""
    scene = tmp_path / "scene.json"
    scene.write_text(
        '{"format": "palpate/scene@1", "object": "tee", "configuration": {"x": 4, "y": -6, "theta": 1}}'
    )
    total, touches = 0.0, 0
    observed, info = env.reset(seed=3, options={"scene": scene})
    assert not any(part.any() for part in observed.values())
    terminated = truncated = False
    while not (terminated or truncated):
        observed, reward, terminated, truncated, info = env.step(info["planned"][0])
        total, touches = total + reward, touches + 1
    assert (terminated, truncated, info["verdict"]) == (True, False, "identified")
    assert total == 10 - touches
    assert observed["left"] == 1
    weight, number, _, x, y, theta, *half = observed["hypotheses"][0]
    assert (weight, env.unwrapped.objects.objects[int(number)].name) == (1.0, "tee")
    assert np.all(np.abs([x - 4, y + 6]) <= half[:2])
    assert abs((theta - 1 + np.pi) % (2 * np.pi) - np.pi) <= half[2]
    assert not observed["hypotheses"][1:].any()
    assert (observed["contacts"][:touches, 0] == 1).all()
    assert not observed["contacts"][touches:].any()


@pytest.mark.parametrize("action", [10**6, -1])
def test_an_action_that_there_is_not_moves_nothing(env: Any, action: int) -> None:
    env.reset(seed=3)
    with pytest.raises(palpate.InputError, match="action is"):
        env.step(action)


def test_a_real_rig_is_refused() -> None:
    from palpate_gymnasium import TouchEnv

    with pytest.raises(palpate.InputError, match="for emulated rigs"):
        TouchEnv(rig=ROOT / "examples" / "real-rig.toml")
