"""Times the training of the pose encoder in PyTorch and in re4-encoder: images per second, and the ratio to PyTorch.

    venv/bin/python benches/encoder_rate.py [--python PYTHON] [--widths 64 16] [--batch 64] [--steps 5] [--rounds 3]
        [--threads 2] [--backends flex torch] [--cuda]

`PYTHON` is an interpreter with torch 2.9.0, by default the one that runs this script. Both sides have the same network (ResNet-18
with another first width, an embedding of 256 and nine outputs), the same random images of 76 x 76 in every step, the mean squared
error as loss, and AdamW; a step is forward, loss, backward and update. The programs alternate, `rounds` times each, with the same
number of threads. The first step of every run is a warm-up; medians over all other steps are compared. PyTorch is timed twice, with
its default memory format and with channels_last.

`flex` is built by `cargo build --release -p re4-encoder --example encoder_rate`; the others with `--features torch` in
`target/torch`, with the LibTorch of `PYTHON` (see docs/encoder.md).
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
CHILD = "--pytorch-side"


def pytorch_side(width: int, batch: int, steps: int, threads: int, layout: str, device: str) -> None:
    import torch
    from torch import nn

    torch.set_num_threads(threads)

    class Block(nn.Module):
        def __init__(self, inside: int, out: int, stride: int) -> None:
            super().__init__()
            self.main = nn.Sequential(
                nn.Conv2d(inside, out, 3, stride, 1, bias=False), nn.BatchNorm2d(out), nn.ReLU(inplace=True),
                nn.Conv2d(out, out, 3, 1, 1, bias=False), nn.BatchNorm2d(out),
            )
            same = stride == 1 and inside == out
            self.side = nn.Identity() if same else nn.Sequential(
                nn.Conv2d(inside, out, 1, stride, bias=False), nn.BatchNorm2d(out)
            )
            self.relu = nn.ReLU(inplace=True)

        def forward(self, x):
            return self.relu(self.main(x) + self.side(x))

    layers = [nn.Conv2d(3, width, 7, 2, 3, bias=False), nn.BatchNorm2d(width), nn.ReLU(inplace=True), nn.MaxPool2d(3, 2, 1)]
    inside = width
    for factor, stride in ((1, 1), (2, 2), (4, 2), (8, 2)):
        out = factor * width
        layers += [Block(inside, out, stride), Block(out, out, 1)]
        inside = out
    layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(inside, 256), nn.Linear(256, 9)]
    form = getattr(torch, layout)
    network = nn.Sequential(*layers).to(device=device, memory_format=form)
    optimiser = torch.optim.AdamW(network.parameters(), 3e-4, weight_decay=1e-4)
    images = torch.randn(batch, 3, 76, 76, device=device).contiguous(memory_format=form)
    seconds = []
    for _ in range(steps + 1):
        start = time.perf_counter()
        loss = network(images).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if device == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    print(json.dumps({"seconds": seconds[1:], "version": torch.__version__}))


def run(command: list, environment: dict) -> tuple[dict, float]:
    """Runs a program. Returns its JSON output and its peak memory in MiB."""
    child = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, text=True, env=environment, cwd=ROOT)
    answer = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        sys.exit(f"{command[0]} ended with exit code {child.returncode}")
    return json.loads(answer), usage.ru_maxrss / 1024


def torch_environment(python: str) -> dict:
    """Environment variables with which the build and the loader find the LibTorch of this Python."""
    script = "import sys, torch, pathlib; print(sys.prefix, pathlib.Path(torch.__file__).parent / 'lib', sep='\\n')"
    prefix, libraries = subprocess.run([python, "-c", script], check=True, capture_output=True, text=True).stdout.split("\n")[:2]
    path = lambda name, first: os.pathsep.join([first, *filter(None, [os.environ.get(name)])])  # noqa: E731
    return os.environ | {
        "LIBTORCH_USE_PYTORCH": "1",
        "VIRTUAL_ENV": prefix,
        "PATH": path("PATH", f"{prefix}/bin"),
        "LD_LIBRARY_PATH": path("LD_LIBRARY_PATH", libraries),
    }


def build(backends: list[str], environment: dict) -> dict[str, pathlib.Path]:
    command = ["cargo", "build", "--release", "--locked", "-q", "-p", "re4-encoder", "--example", "encoder_rate"]
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    programs = {}
    if "flex" in backends:
        subprocess.run(command, check=True, cwd=ROOT)
        programs["flex"] = target / "release/examples/encoder_rate"
    if {"torch", "cuda"} & set(backends):
        own = pathlib.Path(os.environ.get("RE4_TORCH_TARGET", target / "torch"))
        subprocess.run([*command, "--features", "torch", "--target-dir", own], check=True, cwd=ROOT, env=environment)
        programs["torch"] = programs["cuda"] = own / "release/examples/encoder_rate"
    return programs


def main(arguments: argparse.Namespace) -> None:
    environment = torch_environment(arguments.python)
    programs = build(arguments.backends, environment)
    device = "cuda" if arguments.cuda else "cpu"
    sizes = ["--batch", arguments.batch, "--steps", arguments.steps, "--threads", arguments.threads]
    sides = {
        f"PyTorch {layout}": [arguments.python, __file__, CHILD, *sizes, "--layout", layout, "--device", device]
        for layout in ("contiguous_format", "channels_last")
    } | {f"burn {name}": [programs[name], *sizes, "--backend", name] for name in arguments.backends}
    print(f"training images per second, batch {arguments.batch}, 76 x 76, {arguments.threads} threads, {device}, "
          f"medians of {arguments.rounds} x {arguments.steps} steps (min-max)")
    for width in arguments.widths:
        seconds = {name: [] for name in sides}
        memory = dict.fromkeys(sides, 0.0)
        for _ in range(arguments.rounds):
            for name, command in sides.items():
                answer, peak = run([*command, "--width", width], environment)
                seconds[name] += answer["seconds"]
                memory[name] = max(memory[name], peak)
        rates = {name: [arguments.batch / each for each in all_of] for name, all_of in seconds.items()}
        plain = statistics.median(rates["PyTorch contiguous_format"])
        for name, all_of in rates.items():
            middle = statistics.median(all_of)
            print(f"width {width:3}  {name:26} {middle:8.1f} ({min(all_of):.1f}-{max(all_of):.1f})  "
                  f"{middle / plain:5.2f} x PyTorch  {memory[name]:6.0f} MiB", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 16])
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--backends", nargs="+", choices=["flex", "torch", "cuda"], default=["flex", "torch"])
    parser.add_argument("--cuda", action="store_true", help="PyTorch on the graphics card as well")
    for hidden in (CHILD, "--layout", "--device", "--width"):
        parser.add_argument(hidden, help=argparse.SUPPRESS, **({"action": "store_true"} if hidden == CHILD else {}))
    given = parser.parse_args()
    if given.pytorch_side:
        pytorch_side(int(given.width), given.batch, given.steps, given.threads, given.layout, given.device)
    else:
        main(given)
