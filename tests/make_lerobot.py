"""Converts the Push-T demonstrations of a zarr store (format 2) to a LeRobot dataset v3.0.

usage: make_lerobot.py STORE.zarr FOLDER {image,av1,keypoints} [EPISODES]   (needs av, numcodecs, numpy and pyarrow)

    image      PNG images in the tables of data, without loss
    av1        a video, encoded with the settings of the official writer (libsvtav1, crf 30, g 2, preset 12, yuv420p)
    keypoints  the eight corners of the block, no images

Columns are those of lerobot/pusht: next.reward is min(coverage / 0.95, 1) of the next frame; the last frame repeats it.
"""

import json
import struct
import sys
import zlib
from pathlib import Path

import numcodecs
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

FPS = 10
CAMERA = "observation.image"
TASK = "Push the T-shaped blue block onto the T-shaped green target surface."
# gym-pusht's block and goal: a bar of 120 x 30 and a stem of 30 x 90 (px).
BAR = np.array([[-60, 0], [60, 0], [60, 30], [-60, 30]], float)
STEM = np.array([[-15, 30], [15, 30], [15, 120], [-15, 120]], float)
GOAL = (256.0, 256.0, np.pi / 4)
AREA = 6300.0


def array(store, name, rows):
    """The first rows of an array that is divided along its first axis only."""
    folder = store / "data" / name
    meta = json.loads((folder / ".zarray").read_text())
    codec = numcodecs.get_codec(meta["compressor"])
    chunk, shape = meta["chunks"], meta["shape"]
    parts = []
    for number in range(-(-rows // chunk[0])):
        path = folder / ".".join([str(number)] + ["0"] * (len(shape) - 1))
        parts.append(np.frombuffer(codec.decode(path.read_bytes()), meta["dtype"]).reshape(chunk))
    return np.concatenate(parts)[:rows]


def corners(pose):
    x, y, angle = pose
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return [part @ turn.T + (x, y) for part in (BAR, STEM)]


def overlap(subject, window):
    """Area of the intersection of two convex polygons (Sutherland and Hodgman)."""
    points = list(subject)
    for a, b in zip(window, np.roll(window, -1, 0)):
        edge = b - a
        side = [edge[0] * (p[1] - a[1]) - edge[1] * (p[0] - a[0]) for p in points]
        kept = []
        for i, (p, s) in enumerate(zip(points, side)):
            q, t = points[i - 1], side[i - 1]
            if s * t < 0:
                kept.append(q + (p - q) * (t / (t - s)))
            if s >= 0:
                kept.append(p)
        points = kept
        if not points:
            return 0.0
    x, y = np.array(points).T
    return 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def coverage(pose):
    goal = corners(GOAL)
    parts = corners(pose)
    near = np.linalg.norm(np.concatenate(parts).mean(0) - np.concatenate(goal).mean(0)) < 180
    return sum(overlap(part, other) for part in parts for other in goal) / AREA if near else 0.0


def png(pixels):
    height, width, _ = pixels.shape
    # Filter 1 (Sub): each byte minus that of the pixel to the left.
    left = np.concatenate([np.zeros((height, 1, 3), np.uint8), pixels[:, :-1]], 1)
    rows = np.concatenate([np.ones((height, 1), np.uint8), (pixels - left).reshape(height, -1)], 1)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b"")


def write_video(path, images, ends):
    """Each episode is encoded alone; then all are joined without encoding again, as the official writer does."""
    import io

    import av

    path.parent.mkdir(parents=True)
    joined = av.open(str(path), "w")
    stream, start = None, 0
    for number, end in enumerate(ends):
        one = io.BytesIO()
        with av.open(one, "w", format="mp4") as out:
            encoder = out.add_stream("libsvtav1", rate=FPS, options={"crf": "30", "g": "2", "preset": "12"})
            encoder.width, encoder.height, encoder.pix_fmt = images.shape[2], images.shape[1], "yuv420p"
            for pixels in images[start:end]:
                frame = av.VideoFrame.from_ndarray(pixels.astype(np.uint8), "rgb24")
                out.mux(encoder.encode(frame))
            out.mux(encoder.encode())
        one.seek(0)
        with av.open(one) as part:
            source = part.streams.video[0]
            stream = stream or joined.add_stream_from_template(source, opaque=True)
            step = int(1 / FPS / source.time_base)
            for packet in part.demux(source):
                if packet.dts is None:
                    continue
                packet.pts += start * step
                packet.dts += start * step
                packet.stream = stream
                joined.mux(packet)
        start = end
        print(f"\repisode {number + 1} of {len(ends)}", end="", file=sys.stderr)
    joined.close()
    print(file=sys.stderr)


def feature(dtype, shape, names=None, **more):
    return {"dtype": dtype, "shape": list(shape), "names": names, **more}


def statistics(values):
    values = np.asarray(values, float).reshape(len(values), -1)
    by = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    return {**{name: value.tolist() for name, value in by.items()}, "count": [len(values)]}


def main(store, folder, kind, count=None):
    store, folder = Path(store), Path(folder)
    meta = json.loads((store / "meta/episode_ends/.zarray").read_text())
    raw = (store / "meta/episode_ends/0").read_bytes()
    raw = numcodecs.get_codec(meta["compressor"]).decode(raw) if meta["compressor"] else raw
    ends = np.frombuffer(raw, meta["dtype"])[: meta["shape"][0]][: int(count) if count else None].tolist()
    starts, frames = [0, *ends[:-1]], ends[-1]
    state, action = array(store, "state", frames), array(store, "action", frames)
    poses = state[:, 2:5].astype(float)
    covered = np.array([coverage(pose) for pose in poses])
    following = np.concatenate([[*range(s + 1, e), e - 1] for s, e in zip(starts, ends)])
    success = covered > 0.95
    last = np.isin(np.arange(frames), np.array(ends) - 1)

    def vectors(values):
        flat = pa.array(np.ascontiguousarray(values, np.float32).reshape(-1))
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])

    columns = {
        "observation.state": vectors(state[:, :2]),
        "action": vectors(action),
        "next.reward": pa.array(np.minimum(covered / 0.95, 1)[following].astype(np.float32)),
        "next.done": pa.array(last[following]),
        "next.success": pa.array(success[following]),
    }
    pair = {"motors": ["motor_0", "motor_1"]}
    features = {
        "observation.state": feature("float32", [2], pair),
        "action": feature("float32", [2], pair),
        "next.reward": feature("float32", [1]),
        "next.done": feature("bool", [1]),
        "next.success": feature("bool", [1]),
    }
    if kind == "keypoints":
        points = np.array([np.concatenate(corners(pose)).reshape(-1) for pose in poses])
        columns["observation.environment_state"] = vectors(points)
        features["observation.environment_state"] = feature("float32", [16], ["keypoints"])
    else:
        images = array(store, "img", frames)
        side = {"shape": images.shape[1:], "names": ["height", "width", "channel"]}
        if kind == "image":
            encoded = [{"bytes": png(pixels.astype(np.uint8)), "path": None} for pixels in images]
            columns[CAMERA] = pa.array(encoded, pa.struct([("bytes", pa.binary()), ("path", pa.string())]))
            features[CAMERA] = feature("image", **side)
        else:
            video = f"videos/{CAMERA}/chunk-000/file-000.mp4"
            write_video(folder / video, images, ends)
            about = {"height": 96, "width": 96, "codec": "av1", "pix_fmt": "yuv420p", "fps": FPS, "channels": 3}
            about = {f"video.{name}": value for name, value in about.items()}
            features[CAMERA] = feature("video", **side, info={**about, "has_audio": False, "is_depth_map": False})
    number = np.repeat(np.arange(len(ends)), np.diff([0, *ends]))
    inside = np.arange(frames) - np.array(starts)[number]
    columns |= {
        "timestamp": pa.array((inside / FPS).astype(np.float32)),
        "frame_index": pa.array(inside),
        "episode_index": pa.array(number),
        "index": pa.array(np.arange(frames)),
        "task_index": pa.array(np.zeros(frames, np.int64)),
    }
    features |= {"timestamp": feature("float32", [1])}
    features |= {name: feature("int64", [1]) for name in ["frame_index", "episode_index", "index", "task_index"]}

    for place in ["data/chunk-000", "meta/episodes/chunk-000"]:
        (folder / place).mkdir(parents=True)
    table = pa.table(columns)
    with pq.ParquetWriter(folder / "data/chunk-000/file-000.parquet", table.schema) as out:
        for start, end in zip(starts, ends):
            out.write_table(table.slice(start, end - start))
    zeros = [0] * len(ends)
    episodes = {
        "episode_index": list(range(len(ends))),
        "tasks": [[TASK]] * len(ends),
        "length": np.diff([0, *ends]).tolist(),
        "data/chunk_index": zeros,
        "data/file_index": zeros,
        "dataset_from_index": starts,
        "dataset_to_index": ends,
    }
    if kind == "av1":
        place = f"videos/{CAMERA}"
        episodes |= {f"{place}/chunk_index": zeros, f"{place}/file_index": zeros}
        episodes |= {f"{place}/from_timestamp": [start / FPS for start in starts]}
        episodes |= {f"{place}/to_timestamp": [end / FPS for end in ends]}
    episodes |= {"meta/episodes/chunk_index": zeros, "meta/episodes/file_index": zeros}
    pq.write_table(pa.table(episodes), folder / "meta/episodes/chunk-000/file-000.parquet")
    # The official loader expects the text as the index of pandas.
    index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    first = {**index, "name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": [first, index]}
    tasks = pa.table({"task_index": [0], "task": [TASK]}).replace_schema_metadata({"pandas": json.dumps(pandas)})
    pq.write_table(tasks, folder / "meta/tasks.parquet")
    numbers = [name for name in columns if name != CAMERA]
    measured = {name: statistics(table[name].to_pylist()) for name in numbers}
    (folder / "meta/stats.json").write_text(json.dumps(measured, indent=4))
    info = {
        "codebase_version": "v3.0",
        "robot_type": "2d pointer",
        "total_episodes": len(ends),
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": f"0:{len(ends)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4" if kind == "av1" else None,
        "features": features,
    }
    (folder / "meta/info.json").write_text(json.dumps(info, indent=4))


main(*sys.argv[1:])
