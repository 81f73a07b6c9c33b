"""Measures queries over many artifacts, against polars and pyarrow in Python on the same Parquet files.

    python benches/query_rate.py [ARTIFACTS [ROWS]]

Needs polars and pyarrow (`pip install polars pyarrow`) and builds the programs that it times. It makes 10,000 made-up `rollouts`
artifacts with 100 rows each in a temporary folder, or in the folder that QUERY_ARTIFACTS names, which is kept. Every figure is the
median of five runs of a new process, alternating between the programs, with a warm page cache. re4-pipe also reads the manifests and
compares every byte of the files with them; the others do neither.
"""

import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile

ARTIFACTS = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
ROWS = int(sys.argv[2]) if len(sys.argv) > 2 else 100
RUNS = 5
BINARY = "target/release/re4-pipe"
EXAMPLE = "target/release/examples/many_artifacts"

SQL = "select success, count(*) as rollouts, avg(steps) as steps, max(coverage_max) as coverage from results group by success"

POLARS = """
import polars, sys
frame = polars.scan_parquet(sys.argv[1] + "/rollouts/*/results.parquet")
print(frame.group_by("success").agg(
    polars.len(), polars.col("steps").mean(), polars.col("coverage_max").max()).collect(engine="streaming"))
"""

PYARROW = """
import glob, pyarrow.dataset, sys
files = sorted(glob.glob(sys.argv[1] + "/rollouts/*/results.parquet"))
table = pyarrow.dataset.dataset(files).to_table(columns=["success", "steps", "coverage_max"])
print(table.group_by("success").aggregate([([], "count_all"), ("steps", "mean"), ("coverage_max", "max")]))
"""


def timed(command):
    """Wall time in seconds and peak memory in MiB of a process."""
    done = subprocess.run(["/usr/bin/time", "-v", *command], capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    wall = re.search(r"Elapsed \(wall clock\).*: (?:(\d+):)?(\d+):([\d.]+)", done.stderr)
    seconds = 3600 * int(wall[1] or 0) + 60 * int(wall[2]) + float(wall[3])
    return seconds, int(re.search(r"Maximum resident set size.*: (\d+)", done.stderr)[1]) / 1024


def main():
    subprocess.run(["cargo", "build", "--release", "-q", "-p", "re4-pipe"], check=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = os.environ.get("QUERY_ARTIFACTS", temporary)
        if not pathlib.Path(folder, "rollouts").is_dir():
            subprocess.run(["cargo", "build", "--release", "-q", "-p", "re4-pipe", "--example", "many_artifacts"], check=True)
            subprocess.run([EXAMPLE, folder, str(ARTIFACTS), str(ROWS)], check=True)
        commands = {
            "re4-pipe query": [BINARY, "query", SQL, folder],
            "the same, from results joined with settings": [
                BINARY, "query",
                "select s.value as policy, count(*) as rollouts, avg(r.success::int) as success from results r "
                "join settings s using (artifact) where s.name = 'policy.kind' group by s.value",
                folder,
            ],
            "polars (Python)": [sys.executable, "-c", POLARS, folder],
            "pyarrow": [sys.executable, "-c", PYARROW, folder],
        }
        times = {name: [] for name in commands}
        for _ in range(RUNS):
            for name, command in commands.items():
                times[name].append(timed(command))
        print("| program | wall time, s | peak memory, MiB |")
        print("|---|---|---|")
        for name, runs in times.items():
            print(f"| {name} | {statistics.median(t for t, _ in runs):.2f} | {max(m for _, m in runs):.0f} |")


if __name__ == "__main__":
    main()
