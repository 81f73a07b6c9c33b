"""Counts the pixels by which the images of the Push-T demonstrations differ from this crate's renderings of the same states.

Needs zarr 2, numpy and cargo. Run: python compare_dataset_images.py PATH/pusht_cchi_v7_replay.zarr [frames]
The frames are evenly spaced. The dataset's images were rendered with contact marks, by older versions of pygame and pymunk than
those that this crate reproduces; here the states are rendered without contact marks.
"""

import pathlib
import subprocess
import sys

import numpy as np
import zarr

ROOT = pathlib.Path(__file__).resolve().parents[4]


def main() -> None:
    data = zarr.open(sys.argv[1], "r")["data"]
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 24
    frames = np.linspace(0, len(data["state"]) - 1, count).astype(int)
    lines = "".join(" ".join(repr(float(v)) for v in data["state"][frame]) + "\n" for frame in frames)
    command = ["cargo", "run", "--release", "--quiet", "-p", "re4-sim", "--example", "render_states"]
    output = subprocess.run(command, cwd=ROOT, input=lines.encode(), check=True, capture_output=True).stdout
    rendered = np.frombuffer(output, np.uint8).reshape(count, 96, 96, 3).astype(int)
    recorded = np.stack([data["img"][frame] for frame in frames]).astype(int)
    difference = np.abs(rendered - recorded).max(axis=-1)
    pixels = (difference > 0).sum(axis=(1, 2))
    print(f"frames {count}; identical {int((pixels == 0).sum())}")
    print(f"pixels that differ, of 9216: median {np.median(pixels):.0f}, minimum {pixels.min()}, maximum {pixels.max()}")
    print(f"by more than 16 of 255: median {np.median((difference > 16).sum(axis=(1, 2))):.0f}")
    print(f"mean absolute difference over all values: {np.abs(rendered - recorded).mean():.4f} of 255")


if __name__ == "__main__":
    main()
