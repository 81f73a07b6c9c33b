"""Writes seed_states.json: the scenes that diffusion_policy and gym-pusht request for a seed, sampled by numpy.

Needs numpy only. Run: python make_seed_states.py
Each scene is [agent_x, agent_y, block_x, block_y, block_theta] in pixels and radians.
"""

import json
import pathlib

import numpy as np


def diffusion_policy(seed: int) -> list[float]:
    generator = np.random.RandomState(seed)
    scene = [generator.randint(50, 450), generator.randint(50, 450), generator.randint(100, 400), generator.randint(100, 400)]
    return [float(v) for v in scene] + [float(generator.randn() * 2 * np.pi - np.pi)]


def gym_pusht(seed: int) -> list[float]:
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    scene = [generator.integers(50, 450), generator.integers(50, 450), generator.integers(100, 400), generator.integers(100, 400)]
    return [float(v) for v in scene] + [float(generator.uniform(-np.pi, np.pi))]


# Demonstrations (0 to 205), other training scenes, the benchmark's test scenes; and the largest seed, to test integer widths.
SEEDS = {
    diffusion_policy: [*range(206), *range(500, 600), *range(100_000, 100_100), 2**32 - 1],
    gym_pusht: [*range(50), *range(100_000, 100_050), 2**32 - 1],
}


def main() -> None:
    parts = [f' "numpy": "{np.__version__}"']
    for scheme, seeds in SEEDS.items():
        rows = ",\n".join(f'  "{seed}": {json.dumps(scheme(seed))}' for seed in seeds)
        parts.append(f' "{scheme.__name__}": {{\n{rows}\n }}')
    path = pathlib.Path(__file__).with_name("seed_states.json")
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n")


if __name__ == "__main__":
    main()
