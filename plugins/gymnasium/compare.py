"""Policies compared on the emulated bench: python compare.py [EPISODES [RIG.toml OBJECTS.json]]"""

import sys
import warnings
from collections.abc import Callable
from statistics import mean, median

import gymnasium
import numpy as np

import palpate
from palpate_gymnasium import ENV_ID, TouchEnv

Policy = Callable[[TouchEnv, dict[str, list[int]], np.random.Generator], int]


def planned(_: TouchEnv, info: dict[str, list[int]], __: np.random.Generator) -> int:
    """The first approach of the grip that palpate's planner would make."""
    return info["planned"][0]


def at_random(env: TouchEnv, _: dict[str, list[int]], draw: np.random.Generator) -> int:
    """Any approach."""
    return int(draw.integers(len(env.approaches)))


def through_middle(env: TouchEnv, _: dict[str, list[int]], draw: np.random.Generator) -> int:
    """One finger after the other, within 15 mm of the likeliest place: of the table's middle at first."""
    known = env.recognition
    at = known.hypotheses[0].configuration if known.hypotheses else None
    x, y = (0.0, 0.0) if at is None else (at.x_mm, at.y_mm)
    finger = len(known.grips) % (1 + max(item.finger_index for item in env.approaches))
    near = [
        number
        for number, item in enumerate(env.approaches)
        if item.finger_index == finger and item.aside_mm(x, y) < 15.0
    ]
    return int(draw.choice(near))


def episode(env: "gymnasium.Env[object, object]", policy: Policy, seed: int) -> tuple[str, int, float]:
    """Verdict, touches and reward of an episode."""
    draw, total, touches = np.random.default_rng(seed), 0.0, 0
    _, info = env.reset(seed=seed)
    touch_env = env.unwrapped
    assert isinstance(touch_env, TouchEnv)
    while True:
        _, reward, terminated, truncated, info = env.step(policy(touch_env, info, draw))
        total, touches = total + float(reward), touches + 1
        if terminated or truncated:
            return info["verdict"], touches, total


def main(episodes: int = 20, *files: str) -> None:
    """Print a table, a line for each policy; every policy gets the same parts."""
    warnings.simplefilter("ignore", palpate.RigWarning)
    env = gymnasium.make(ENV_ID, **dict(zip(("rig", "objects"), files, strict=False)))
    print("| policy | identified | touches, median | most | reward, mean |\n|---|---|---|---|---|")
    for policy in (planned, through_middle, at_random):
        ended = [episode(env, policy, seed) for seed in range(episodes)]
        found = sum(verdict == "identified" for verdict, _, _ in ended)
        touches = [count for _, count, _ in ended]
        words = policy.__name__.replace("_", " ")
        reward = mean(total for _, _, total in ended)
        print(
            f"| {words} | {found} of {episodes} | {median(touches):g} | {max(touches)} | {reward:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(int((sys.argv[1:] or ["20"])[0]), *sys.argv[2:])
