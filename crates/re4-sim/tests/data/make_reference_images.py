"""Writes reference_images.json and images/*.png: frames that gym-pusht 0.1.8 rendered, for byte-exact comparison.

Needs gym-pusht 0.1.8 (which installs numpy, pymunk, pygame and opencv). Run: python make_reference_images.py

Every other episode follows random targets over the whole window, the others push the block; every fourth starts near the
goal. Within an episode, frames are taken at fixed intervals and, in between, at steps with contact marks. Each frame is
stored as the first 16 bytes of the SHA-256 of its 512 x 512 x 3 and of its 96 x 96 x 3 bytes, rows from the top, RGB.
`marked` frames differ from the same scene rendered without contact marks.
"""

import hashlib
import importlib.metadata
import json
import os
import pathlib

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import cv2
import gym_pusht.envs.pusht
import numpy as np
import pygame
from pymunk import SpaceDebugDrawOptions

EPISODES, STEPS, INTERVAL = 24, 60, 12
FULL_IMAGES = 6


def sha(image: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(image).tobytes()).hexdigest()[:32]


def canvas_of(env) -> np.ndarray:
    return np.ascontiguousarray(np.transpose(pygame.surfarray.array3d(env._draw()), (1, 0, 2)))


def unmarked_canvas_of(env) -> np.ndarray:
    """The canvas rendered without contact marks."""
    usual = gym_pusht.envs.pusht.DrawOptions

    def without_contacts(surface):
        options = usual(surface)
        options.flags = SpaceDebugDrawOptions.DRAW_SHAPES
        return options

    gym_pusht.envs.pusht.DrawOptions = without_contacts
    try:
        return canvas_of(env)
    finally:
        gym_pusht.envs.pusht.DrawOptions = usual


def scene_for(generator, episode: int) -> np.ndarray:
    scene = np.concatenate([generator.uniform(50, 450, 2), generator.uniform(100, 400, 2), generator.uniform(-4, 4, 1)])
    if episode % 4 == 3:
        x, y, theta = np.array([256, 256, np.pi / 4]) + generator.normal(0.0, [8, 8, 0.1])
        # The reset rotates the block about (0, 45) after it sets the position.
        scene[2:] = [x - 45 * np.sin(theta), y - 45 + 45 * np.cos(theta), theta]
    return scene


def target(generator, env, pushing: bool, previous: np.ndarray) -> np.ndarray:
    if not pushing:
        return generator.uniform(0.0, 512.0, 2)
    if generator.random() < 0.8:
        return previous
    centre = np.array(env.block.local_to_world(env.block.center_of_gravity))
    return np.clip(centre + generator.normal(0.0, 35.0, 2), 0.0, 512.0)


def main() -> None:
    generator = np.random.default_rng(11)
    env = gym_pusht.envs.pusht.PushTEnv(obs_type="pixels", render_mode="rgb_array")
    here = pathlib.Path(__file__).parent
    folder = here / "images"
    folder.mkdir(exist_ok=True)
    episodes, counts, full = [], {"frames": 0, "marked": 0}, 0
    for episode in range(EPISODES):
        pushing = episode % 2 == 1
        scene = scene_for(generator, episode)
        image, _ = env.reset(options={"reset_to_state": scene})
        action, actions, frames, last_marked = np.array(env.agent.position), [], [], -4
        for step in range(STEPS + 1):
            if step > 0:
                action = target(generator, env, pushing, action).astype(np.float32).astype(np.float64)
                image = env.step(action)[0]
                actions.append(action.tolist())
            canvas = canvas_of(env)
            assert np.array_equal(cv2.resize(canvas, (96, 96)), image)
            marked = not np.array_equal(canvas, unmarked_canvas_of(env))
            if step % INTERVAL and not (marked and step >= last_marked + 4):
                continue
            if marked:
                last_marked = step
            frame = {"step": step, "marked": marked, "canvas": sha(canvas), "observation": sha(image)}
            if marked and step > 8 and episode % (EPISODES // FULL_IMAGES) == 1 and not any("image" in f for f in frames):
                frame["image"] = f"{episode:02}_{step:02}.png"
                cv2.imwrite(str(folder / frame["image"]), image[:, :, ::-1])
                full += 1
            frames.append(frame)
            counts["frames"] += 1
            counts["marked"] += marked
        episodes.append({"scene": scene.tolist(), "actions": actions, "frames": frames})
    names = ("gym-pusht", "pymunk", "pygame", "opencv-python", "numpy")
    versions = {name: importlib.metadata.version(name) for name in names}
    path = here / "reference_images.json"
    lines = ",\n".join(json.dumps(episode) for episode in episodes)
    path.write_text(f'{{"versions": {json.dumps(versions)},\n"episodes": [\n{lines}\n]}}\n')
    print(f"{path.name}: {path.stat().st_size} bytes; {counts}; {full} full images; {versions}")


if __name__ == "__main__":
    main()
