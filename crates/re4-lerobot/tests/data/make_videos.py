"""Writes small videos in which frames are decoded in another order than they are shown, and the SHA-256 of their planes by PyAV.

    pip install av numpy; python crates/re4-lerobot/tests/data/make_videos.py
"""

import hashlib
import pathlib

import av
import numpy as np

FOLDER = pathlib.Path(__file__).resolve().parent
VIDEOS = [
    ("hidden_frames.mp4", "libsvtav1", {"crf": "35", "g": "60", "preset": "8"}),
    ("b_frames.mp4", "libx264", {"crf": "23", "g": "40", "bf": "3", "preset": "slow"}),
]


def image(i):
    rows, columns = np.mgrid[0:48, 0:64]
    disc = (rows - 24 - 12 * np.sin(i / 6)) ** 2 + (columns - 32 - 20 * np.cos(i / 5)) ** 2 < 60
    background = np.stack([2 * columns, 3 * rows, columns + rows], 2) + 20
    return np.where(disc[..., None], [200, 60, 40], background).astype(np.uint8)


def planes(path):
    digest = hashlib.sha256()
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            for plane, scale in zip(frame.planes, (1, 2, 2)):
                data = np.frombuffer(bytes(plane), np.uint8).reshape(-1, plane.line_size)
                digest.update(data[: frame.height // scale, : frame.width // scale].tobytes())
    return digest.hexdigest()


lines = []
for name, codec, options in VIDEOS:
    with av.open(str(FOLDER / name), "w") as out:
        stream = out.add_stream(codec, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for i in range(90):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(image(i), format="rgb24")))
        out.mux(stream.encode())
    lines.append(f"{planes(FOLDER / name)}  {name}\n")
(FOLDER / "DECODED_SHA256").write_text("".join(lines))
