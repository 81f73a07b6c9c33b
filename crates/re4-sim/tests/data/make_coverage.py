"""Writes coverage.json: coverage and intersection over union of T poses with the Push-T goal, computed by shapely.

Needs numpy and shapely. Run: python make_coverage.py
Each row is [block_x, block_y, block_theta, coverage, iou]; the shapes are gym-pusht's two rectangles.
"""

import json
import math
import pathlib

import numpy as np
import shapely
from shapely import affinity

GOAL = (256.0, 256.0, math.pi / 4)
TEE = shapely.union_all([shapely.box(-60, 0, 60, 30), shapely.box(-15, 30, 15, 120)])


def placed(x: float, y: float, theta: float) -> shapely.Geometry:
    return affinity.translate(affinity.rotate(TEE, theta, origin=(0, 0), use_radians=True), x, y)


def main() -> None:
    generator = np.random.default_rng(20_240_607)
    poses = [GOAL, (256.0, 256.0, math.pi / 4 + math.pi), (256.0, 256.0, 0.0), (356.0, 256.0, math.pi / 4), (50.0, 50.0, 1.0)]
    for spread in (2.0, 10.0, 40.0, 120.0):
        for _ in range(50):
            x, y = generator.normal(256.0, spread, 2)
            theta = math.pi / 4 + generator.normal(0.0, spread / 40.0)
            poses.append((x, y, theta))
    goal = placed(*GOAL)
    rows = []
    for pose in poses:
        block = placed(*pose)
        overlap = goal.intersection(block).area
        rows.append([*map(float, pose), float(overlap / goal.area), float(overlap / goal.union(block).area)])
    text = ",\n".join("  " + json.dumps(row) for row in rows)
    path = pathlib.Path(__file__).with_name("coverage.json")
    path.write_text(f'{{\n "shapely": "{shapely.__version__}",\n "rows": [\n{text}\n ]\n}}\n')


if __name__ == "__main__":
    main()
