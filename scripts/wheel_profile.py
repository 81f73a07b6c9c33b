"""Prints the cargo profile of the wheel: as small as possible, except for the crates in which time is spent.

The profile `release` compiles crates that take no part in a run without optimization, to save build time. Their code is then several times
as large, which the wheel cannot afford.
"""

import tomllib
from pathlib import Path

# Simulation, Retrieve, networks, images, compression, hashing.
FAST = """
blake3 burn-flex fdeflate gemm gemm-common gemm-f32 image kiddo macerator matrixmultiply miniz_oxide parquet png pulp rav1d rayon rayon-core
re4-encoder re4-generative re4-geometry re4-index re4-influence re4-ingest re4-lerobot re4-mujoco re4-policy re4-pose re4-robosuite
re4-rollout re4-scores re4-segment re4-sim re4-stats re4-train rust_h264 rustfft zlib-rs
"""

release = tomllib.loads(Path(__file__).parent.joinpath("../Cargo.toml").read_text())["profile"]["release"]
print('[profile.wheel]\ninherits = "release"\nopt-level = "s"\n\n[profile.wheel.package]')
for name, settings in release["package"].items():
    if settings["opt-level"] == 0:
        print(f'"{name}" = {{ opt-level = "s" }}')
for name in FAST.split():
    print(f'"{name}" = {{ opt-level = 3 }}')
