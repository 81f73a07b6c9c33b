"""Records episodes of gym-pusht for the tests of re4/PushT-v0.

    python record_gym_pusht.py      (needs gym-pusht 0.1.8: pip install gym-pusht==0.1.8)

Writes gym_pusht.json.gz: for every observation type, two episodes after each other (the second without a seed) and an episode from a
given state, with actions, observations, rewards, ends and infos. Images are SHA-256 hashes. The last entry of a step is the number of
contact points that gym-pusht counted in it, from which it derives `n_contacts`.
"""

import gzip
import hashlib
import json
import warnings
from pathlib import Path

import numpy as np

warnings.simplefilter("ignore")
import gym_pusht  # noqa: E402, F401
import gymnasium  # noqa: E402

STEPS = 12


def plain(value):
    """A value as JSON; images become hashes."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    return np.asarray(value).tolist()


def main() -> None:
    episodes = []
    for obs_type in ("state", "environment_state_agent_pos", "pixels", "pixels_agent_pos"):
        env = gymnasium.make("gym_pusht/PushT-v0", obs_type=obs_type, disable_env_checker=True)
        random = np.random.default_rng(7)
        starts = [{"seed": 200_003}, {}, {"options": {"reset_to_state": [100.0, 300.0, 256.0, 260.0, 0.7]}}]
        for start in starts:
            observation, info = env.reset(**start)
            steps, first_info = [], plain(info)
            for _ in range(STEPS):
                # Towards the block, so that there are contacts.
                action = (info["block_pose"][:2] + random.uniform(-40, 40, 2)).astype(np.float32)
                after, reward, terminated, truncated, info = env.step(action)
                points = env.unwrapped.n_contact_points
                steps.append([plain(action), plain(after), reward, bool(terminated), truncated, plain(info), points])
            episodes.append({"obs_type": obs_type, "start": start, "first": plain(observation), "first_info": first_info, "steps": steps})
    text = json.dumps({"episodes": episodes}).encode()
    path = Path(__file__).with_name("gym_pusht.json.gz")
    path.write_bytes(gzip.compress(text, compresslevel=9, mtime=0))
    print(path.name, path.stat().st_size, sum(step[6] > 0 for e in episodes for step in e["steps"]))


if __name__ == "__main__":
    main()
