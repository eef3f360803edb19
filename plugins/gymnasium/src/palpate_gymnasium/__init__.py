"""palpate's emulated bench as the Gymnasium environment `palpate/Touch-v0`."""

import gymnasium

from palpate_gymnasium.touch_env import TouchEnv

__all__ = ["ENV_ID", "TouchEnv"]

ENV_ID = "palpate/Touch-v0"
"""Name under which importing this package registers the environment."""

gymnasium.register(ENV_ID, entry_point="palpate_gymnasium:TouchEnv")
