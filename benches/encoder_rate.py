"""Times the training of the pose encoder in PyTorch and in re4-encoder: images a second, and the ratio to PyTorch.

    venv/bin/python benches/encoder_rate.py [--python PYTHON] [--networks keypoints:16 resnet18:16] [--batch 64] [--steps 5]
        [--rounds 3] [--threads 2] [--backends flex torch] [--cuda]

`PYTHON` is one with torch 2.9.0, by default the one that runs this. Both sides have the same network, `NAME:WIDTH`: the keypoint
network of preset `re4`, or a ResNet-18 with another first width, an embedding of 256 and nine numbers. A step is forward, loss,
backward and update by AdamW. PyTorch repeats it on the same random images with the mean square as loss; re4-encoder also reads
and crops the images of every step and computes the losses of the preset. The programs run in turn, `rounds` times each, with the
same number of threads; the first five steps of every run only warm up. Medians over all other steps are compared. PyTorch is
timed twice, with its default memory format and with channels_last.

`flex` is built by `cargo build --release -p re4-encoder --example encoder_rate`; the others with `--features torch` in
`target/torch`, with LibTorch taken from `PYTHON` (docs/concepts/encoder.md says how).
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
WARM_UP = 5


def pytorch_side(name: str, width: int, batch: int, steps: int, threads: int, layout: str, device: str) -> None:
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

    class Keypoints(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            layers = []
            inside = 3
            for kernel, stride, dilation in ((5, 2, 1), (3, 1, 1), (3, 1, 2)):
                padding = dilation * (kernel - 1) // 2
                layers += [nn.Conv2d(inside, width, kernel, stride, padding, dilation, bias=False),
                           nn.GroupNorm(width // 4, width), nn.ReLU(inplace=True)]
                inside = width
            self.trunk = nn.Sequential(*layers, nn.Conv2d(width, 2 * width, 3, 1, 1, bias=False))
            head = lambda hidden, out: nn.ModuleList([  # noqa: E731
                nn.Sequential(nn.Linear(4 * width, hidden), nn.ReLU(), nn.Linear(hidden, out)),
                nn.Linear(4 * width, out, bias=False)])
            self.heads = nn.ModuleList([head(8, 3), head(64, 6)])
            self.register_buffer("at", torch.linspace(-1, 1, 38))

        def forward(self, x):
            maps = self.trunk(x)
            weights = maps.flatten(2).softmax(-1).view_as(maps)
            points = torch.cat([(weights.sum(2) * self.at).sum(2), (weights.sum(3) * self.at).sum(2)], 1)
            return torch.cat([deep(points) + skip(points) for deep, skip in self.heads], 1)

    layers = [nn.Conv2d(3, width, 7, 2, 3, bias=False), nn.BatchNorm2d(width), nn.ReLU(inplace=True), nn.MaxPool2d(3, 2, 1)]
    inside = width
    for factor, stride in ((1, 1), (2, 2), (4, 2), (8, 2)):
        out = factor * width
        layers += [Block(inside, out, stride), Block(out, out, 1)]
        inside = out
    layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(inside, 256), nn.Linear(256, 9)]
    form = getattr(torch, layout)
    network = Keypoints() if name == "keypoints" else nn.Sequential(*layers)
    network = network.to(device=device, memory_format=form)
    optimiser = torch.optim.AdamW(network.parameters(), 3e-4, weight_decay=1e-4)
    images = torch.randn(batch, 3, 76, 76, device=device).contiguous(memory_format=form)
    seconds = []
    for _ in range(steps + WARM_UP):
        start = time.perf_counter()
        loss = network(images).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if device == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    print(json.dumps({"seconds": seconds[WARM_UP:], "version": torch.__version__}))


def run(command: list, environment: dict) -> tuple[dict, float]:
    """Its answer, and the most memory that it used in MiB."""
    child = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, text=True, env=environment, cwd=ROOT)
    answer = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        sys.exit(f"{command[0]} ended with exit code {child.returncode}")
    return json.loads(answer), usage.ru_maxrss / 1024


def torch_environment(python: str) -> dict:
    """Where the build and the loader find the LibTorch of this Python."""
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
    print(f"training images a second, batch {arguments.batch}, 76 x 76, {arguments.threads} threads, {device}, "
          f"medians of {arguments.rounds} x {arguments.steps} steps (min-max)")
    for name, width in (each.split(":") for each in arguments.networks):
        network = ["--network", name, "--width", width]
        seconds = {name: [] for name in sides}
        memory = dict.fromkeys(sides, 0.0)
        for _ in range(arguments.rounds):
            for side, command in sides.items():
                answer, most = run([*command, *network], environment)
                seconds[side] += answer["seconds"]
                memory[side] = max(memory[side], most)
        rates = {side: [arguments.batch / each for each in all_of] for side, all_of in seconds.items()}
        plain = statistics.median(rates["PyTorch contiguous_format"])
        for side, all_of in rates.items():
            middle = statistics.median(all_of)
            print(f"{name:9} width {width:3}  {side:26} {middle:8.1f} ({min(all_of):.1f}-{max(all_of):.1f})  "
                  f"{middle / plain:5.2f} x PyTorch  {memory[side]:6.0f} MiB", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--networks", nargs="+", default=["keypoints:16", "resnet18:16", "resnet18:64"])
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--backends", nargs="+", choices=["flex", "torch", "cuda"], default=["flex", "torch"])
    parser.add_argument("--cuda", action="store_true", help="PyTorch on the graphics card as well")
    for hidden in (CHILD, "--layout", "--device", "--network", "--width"):
        parser.add_argument(hidden, help=argparse.SUPPRESS, **({"action": "store_true"} if hidden == CHILD else {}))
    given = parser.parse_args()
    if given.pytorch_side:
        pytorch_side(given.network, int(given.width), given.batch, given.steps, given.threads, given.layout, given.device)
    else:
        main(given)
