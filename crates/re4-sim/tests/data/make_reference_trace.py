"""Writes reference_trace.bin: 40 episodes of 300 steps simulated by gym-pusht 0.1.8, for bit-exact comparison.

Needs gym-pusht 0.1.8 (which installs numpy, pymunk and shapely). Run: python make_reference_trace.py
Half of the episodes follow random targets, half push the block; half of the latter start near the goal. An episode
continues after success.

All numbers are little-endian; E episodes, S steps, one full state every K steps:
  magic b"PUSHT-T1", u32 length and UTF-8 text naming the versions, u32 E, u32 S, u32 K
  f64 [E, 5]       requested scene: agent x, y, block x, y, theta
  f64 [E, 7]       state after the reset: agent x, y, agent velocity x, y, block x, y, theta in [0, 2 pi)
  f32 [E, S, 2]    actions
  u8  [E, S]       contact points of the step, over its ten physics steps
  f64 [E, S]       coverage
  u64 [E, S]       FNV-1a hash of the 56 bytes of the state after the step
  f64 [E, S/K, 7]  state after the steps K-1, 2K-1, ...
"""

import importlib.metadata
import pathlib
import struct

import gym_pusht.envs.pusht
import numpy as np

EPISODES, STEPS, STRIDE = 40, 300, 10


def state_of(env) -> np.ndarray:
    return np.array(
        [*env.agent.position, *env.agent.velocity, *env.block.position, env.block.angle % (2 * np.pi)], dtype="<f8"
    )


def fnv1a(states: np.ndarray) -> np.ndarray:
    """One hash per row; the rows are 56 bytes long."""
    rows = np.ascontiguousarray(states, dtype="<f8").view(np.uint8).reshape(-1, 56)
    hashes = np.full(len(rows), 0xCBF29CE484222325, dtype=np.uint64)
    for column in rows.T:
        hashes = (hashes ^ column.astype(np.uint64)) * np.uint64(0x100000001B3)
    return hashes


def request_for(pose: np.ndarray) -> list[float]:
    """The pose to request of gym-pusht's reset so that the block arrives at `pose`.

    The reset rotates the block about (0, 45) after it sets the position.
    """
    x, y, theta = pose
    return [x - 45 * np.sin(theta), y - 45 + 45 * np.cos(theta), theta]


def target(generator, env, pushing: bool, previous: np.ndarray) -> np.ndarray:
    if not pushing:
        return generator.uniform(0.0, 512.0, 2)
    # Keep a target for some steps so that pushes are long, then aim near the block's centre of gravity again.
    if generator.random() < 0.8:
        return previous
    centre = np.array(env.block.local_to_world(env.block.center_of_gravity))
    return np.clip(centre + generator.normal(0.0, 35.0, 2), 0.0, 512.0)


def main() -> None:
    generator = np.random.default_rng(7)
    env = gym_pusht.envs.pusht.PushTEnv(obs_type="state")
    scenes = np.zeros((EPISODES, 5), dtype="<f8")
    first = np.zeros((EPISODES, 7), dtype="<f8")
    actions = np.zeros((EPISODES, STEPS, 2), dtype="<f4")
    contacts = np.zeros((EPISODES, STEPS), dtype=np.uint8)
    coverage = np.zeros((EPISODES, STEPS), dtype="<f8")
    states = np.zeros((EPISODES, STEPS, 7), dtype="<f8")
    for episode in range(EPISODES):
        pushing = episode % 2 == 1
        scenes[episode, :2] = generator.uniform(50.0, 450.0, 2)
        scenes[episode, 2:4] = generator.uniform(100.0, 400.0, 2)
        scenes[episode, 4] = generator.normal() * 2 * np.pi - np.pi
        if episode % 4 == 3:
            scenes[episode, 2:] = request_for(np.array([256, 256, np.pi / 4]) + generator.normal(0.0, [8, 8, 0.1]))
        env.reset(options={"reset_to_state": scenes[episode]})
        first[episode] = state_of(env)
        action = np.array(env.agent.position)
        for step in range(STEPS):
            # Stored as f32 to save space; both simulators get its exact value as f64.
            action = target(generator, env, pushing, action).astype(np.float32).astype(np.float64)
            _, _, _, _, info = env.step(action)
            actions[episode, step] = action
            contacts[episode, step] = env.n_contact_points
            coverage[episode, step] = info["coverage"]
            states[episode, step] = state_of(env)

    names = ("gym-pusht", "pymunk", "numpy", "shapely")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names).encode()
    path = pathlib.Path(__file__).with_name("reference_trace.bin")
    with path.open("wb") as file:
        file.write(b"PUSHT-T1" + struct.pack("<I", len(versions)) + versions)
        file.write(struct.pack("<III", EPISODES, STEPS, STRIDE))
        hashes = fnv1a(states).astype("<u8")
        for array in (scenes, first, actions, contacts, coverage, hashes, states[:, STRIDE - 1 :: STRIDE]):
            file.write(np.ascontiguousarray(array).tobytes())
    touching = int((contacts > 0).sum())
    print(f"{path.name}: {path.stat().st_size} bytes; {touching} of {EPISODES * STEPS} steps had contacts; {versions.decode()}")


if __name__ == "__main__":
    main()
