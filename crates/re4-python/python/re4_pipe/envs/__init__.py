"""gymnasium environments over the native simulators.

Importing this module registers them, so ``gymnasium.make("re4_pipe.envs:re4/PushT-v0")`` works without an import:

====================  ======================================  =====  ==================
id                    task                                    rate   limit in steps
====================  ======================================  =====  ==================
``re4/PushT-v0``      push a T-shaped block onto its goal     10 Hz  300
``re4/Lift-v0``       lift a cube (robosuite)                 20 Hz  400
``re4/Can-v0``        place a can in its bin (robosuite)      20 Hz  400
``re4/Square-v0``     put a square nut on its peg (robosuite) 20 Hz  400
====================  ======================================  =====  ==================

``gymnasium.make_vec`` makes the native vector form of each, in which one call steps all environments on several threads.
Needs the package gymnasium (``pip install 're4-pipe[gym]'``).
"""

from __future__ import annotations

import gymnasium

from .pusht import PushTEnv, PushTVectorEnv
from .robosuite import RobosuiteEnv, RobosuiteVectorEnv

__all__ = ["PushTEnv", "PushTVectorEnv", "RobosuiteEnv", "RobosuiteVectorEnv"]

_PUSHT_STEPS = 300
_ROBOSUITE_STEPS = 400


def _register() -> None:
    module = __name__
    if "re4/PushT-v0" in gymnasium.registry:
        return
    gymnasium.register(
        "re4/PushT-v0",
        entry_point=f"{module}.pusht:PushTEnv",
        vector_entry_point=f"{module}.pusht:PushTVectorEnv",
        max_episode_steps=_PUSHT_STEPS,
    )
    for task in ("lift", "can", "square"):
        gymnasium.register(
            f"re4/{task.capitalize()}-v0",
            entry_point=f"{module}.robosuite:RobosuiteEnv",
            vector_entry_point=f"{module}.robosuite:RobosuiteVectorEnv",
            max_episode_steps=_ROBOSUITE_STEPS,
            kwargs={"task": task},
        )


_register()
