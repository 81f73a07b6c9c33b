"""Poses from images: re4-pipe train-pose against the paper's closed form written with OpenCV and numpy.

    python benches/poses.py <pusht_cchi_v7_replay.zarr> [binary]

Both estimate the poses of all 25,650 frames on one thread. The OpenCV program has its images as bytes in memory; re4-pipe reads
them from the artifact, decodes them, estimates and writes the poses. Errors are differences from the recorded poses.
"""

import json
import os
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np
import zarr

SCALE = 512 / 96
GOAL = np.array([256.0, 256.0, np.pi / 4])
# The centroid of the T in its own frame: a bar of 3600 px^2 about (0, 15) and a stem of 2700 about (0, 75).
CENTROID = np.array([0.0, (3600 * 15 + 2700 * 75) / 6300])
ANGLES, RADII, REACH = 180, 16, 92 / SCALE


def rotated(vector, angle):
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])


def polar(mask, centroid):
    """Spectrum along the angle of the mask in log-polar coordinates; rows are angles."""
    flags = cv2.INTER_LINEAR | cv2.WARP_POLAR_LOG
    return np.fft.rfft(cv2.warpPolar(mask.astype(np.float32), (RADII, ANGLES), tuple(centroid), REACH, flags), axis=0)


def largest_region(mask):
    _, labels, statistics, centroids = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    chosen = 1 + np.argmax(statistics[1:, cv2.CC_STAT_AREA])
    return labels == chosen, centroids[chosen]


def estimate(image, anchor):
    red, green, blue = (image[..., i].astype(np.int16) for i in range(3))
    excess = blue - red
    mask, centroid = largest_region((excess >= 17) & (excess <= 50) & (red - green <= 6))
    correlation = np.fft.irfft((polar(mask, centroid) * anchor.conj()).sum(axis=1), n=ANGLES)
    peak = int(np.argmax(correlation))
    before, top, after = correlation[peak - 1], correlation[peak], correlation[(peak + 1) % ANGLES]
    shift = peak + 0.5 * (before - after) / (before - 2 * top + after)
    angle = GOAL[2] + 2 * np.pi * shift / ANGLES
    position = (centroid + 0.5) * SCALE - 0.5 - rotated(CENTROID, angle)
    return position[0], position[1], angle % (2 * np.pi)


def spread(errors):
    return " / ".join(f"{np.quantile(errors, q):.2f}" for q in (0.5, 0.9, 0.99, 1.0))


def main():
    dataset = sys.argv[1]
    binary = sys.argv[2] if len(sys.argv) > 2 else "target/release/re4-pipe"
    cv2.setNumThreads(1)
    store = zarr.open(dataset, "r")
    images = np.concatenate([store["data/img"][i : i + 1000].astype(np.uint8) for i in range(0, len(store["data/img"]), 1000)])
    states = store["data/state"][:]

    start = time.perf_counter()
    green = images[::16].astype(np.int16)
    goal = (green[..., 1] - np.maximum(green[..., 0], green[..., 2])).max(axis=0) > 47
    anchor = polar(*largest_region(goal))
    poses = np.array([estimate(image, anchor) for image in images])
    rival = time.perf_counter() - start
    position = np.hypot(*(poses[:, :2] - states[:, 2:4]).T)
    angle = np.degrees(np.abs((poses[:, 2] - states[:, 4] + np.pi) % (2 * np.pi) - np.pi))
    print(f"OpenCV and numpy: {rival:.2f} s; position px {spread(position)}; angle degrees {spread(angle)}  (p50 / p90 / p99 / max)")

    environment = os.environ | {"RE4_DATA": os.path.dirname(os.path.dirname(os.path.abspath(dataset)))}
    for refine in ("false", "true"):
        with tempfile.TemporaryDirectory() as artifacts:
            command = [binary, "train-pose", "pipelines/pusht-image.toml", "--jobs", "1", "--json", "--quiet",
                       "--artifacts", artifacts, "--set", f"pose.refine={refine}"]
            answer = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout)
        evaluation = answer["summary"]["evaluation"]
        figures = [" / ".join(f"{evaluation[name][key]:.2f}" for key in ("p50", "p90", "p99", "max")) for name in ("position_px", "angle_deg")]
        wall = answer["wall_s"]
        print(f"re4-pipe, refine = {refine}: {wall:.2f} s, {rival / wall:.1f} times as fast; position px {figures[0]}; angle degrees {figures[1]}")


if __name__ == "__main__":
    main()
