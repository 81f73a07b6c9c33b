"""Compares the decoding of LeRobot videos with PyAV: the same frames, to RGB, in one run.

    cargo build --release -p re4-lerobot --example lerobot_inspect
    python benches/lerobot_video.py target/release/examples/lerobot_inspect DATASET... [--large DIR]

Needs `av` and `numpy`; `--large` also needs `pyarrow` and writes datasets with 640 x 480 videos (AV1 and H.264) to DIR first. For each
dataset, the programs alternate and the minimum of five rounds counts. PyAV decodes with the threads that it chooses itself.
"""

import json
import os
import pathlib
import re
import subprocess
import sys
import time

import av
import numpy as np


def large(folder, codec, options):
    """Writes a v2.1 dataset of two episodes with 150 frames of 640 x 480 pixels each."""
    root = pathlib.Path(folder) / f"large-{codec}"
    if root.exists():
        return root
    import pyarrow as pa
    import pyarrow.parquet as pq

    fps, length = 30, 150
    rows, columns = np.mgrid[0:480, 0:640]
    generator = np.random.default_rng(7)
    texture = generator.integers(0, 60, (480, 640, 3))
    for episode in range(2):
        path = root / f"videos/chunk-000/camera/episode_{episode:06d}.mp4"
        path.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(path), "w") as out:
            stream = out.add_stream(codec, rate=fps, options=options)
            stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
            for i in range(length):
                disc = (rows - 240 - 150 * np.sin(i / 20)) ** 2 + (columns - 320 - 200 * np.cos(i / 15 + episode)) ** 2 < 3600
                image = texture + 90 + (np.stack([columns, rows, columns + rows], 2) // 12)
                image[disc] = (200, 60, 40)
                frame = av.VideoFrame.from_ndarray(image.clip(0, 255).astype(np.uint8), format="rgb24")
                out.mux(stream.encode(frame))
            out.mux(stream.encode())
        data = root / f"data/chunk-000/episode_{episode:06d}.parquet"
        data.parent.mkdir(parents=True, exist_ok=True)
        counted = pa.array(np.arange(length), pa.int64())
        table = {
            "timestamp": pa.array((np.arange(length) / fps).astype(np.float32)),
            "frame_index": counted,
            "episode_index": pa.array([episode] * length, pa.int64()),
            "index": pa.array(np.arange(length) + episode * length, pa.int64()),
            "task_index": pa.array([0] * length, pa.int64()),
        }
        pq.write_table(pa.table(table), data)
    meta = root / "meta"
    meta.mkdir(exist_ok=True)
    video = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]}
    info = {"codebase_version": "v2.1", "fps": fps, "features": {"camera": video}, "total_episodes": 2}
    (meta / "info.json").write_text(json.dumps(info))
    (meta / "tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": "Follow the disc."}) + "\n")
    lines = [json.dumps({"episode_index": e, "tasks": ["Follow the disc."], "length": length}) for e in range(2)]
    (meta / "episodes.jsonl").write_text("\n".join(lines))
    return root


def by_pyav(files):
    """Frames, and seconds to decode all of them to RGB arrays."""
    start, frames = time.perf_counter(), 0
    for file in files:
        with av.open(str(file)) as container:
            for frame in container.decode(video=0):
                frame.to_ndarray(format="rgb24")
                frames += 1
    return frames, time.perf_counter() - start


def by_re4(program, dataset):
    """Frames and seconds as the program states them, and its peak memory in MiB."""
    process = subprocess.Popen([program, str(dataset), "--decode"], stdout=subprocess.PIPE, text=True)
    text = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0, text
    found = re.findall(r"decoded +(\d+) images of \S+ in ([\d.]+) s", text)
    return sum(int(n) for n, _ in found), sum(float(s) for _, s in found), usage.ru_maxrss / 1024


def main(arguments):
    if "--large" in arguments:
        at = arguments.index("--large")
        folder = arguments[at + 1]
        arguments[at : at + 2] = [
            str(large(folder, "libsvtav1", {"crf": "30", "g": "2", "preset": "10"})),
            str(large(folder, "libx264", {"crf": "30", "g": "2"})),
        ]
    program, *datasets = arguments
    print(f"PyAV {av.__version__}, {os.cpu_count()} CPUs, load {os.getloadavg()[0]:.1f}")
    for dataset in map(pathlib.Path, datasets):
        files = sorted(dataset.glob("videos/**/*.mp4"))
        ours, theirs, memory = [], [], 0
        for _ in range(5):
            n, seconds, peak = by_re4(program, dataset)
            m, other = by_pyav(files)
            assert n == m, (n, m)
            ours.append(seconds)
            theirs.append(other)
            memory = max(memory, peak)
        ratio = min(theirs) / min(ours)
        print(f"{dataset.name}: {n} frames, re4-lerobot {min(ours):.3f} s, PyAV {min(theirs):.3f} s, {ratio:.2f}x, peak {memory:.0f} MiB")


main(sys.argv[1:])
