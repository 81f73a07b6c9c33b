"""Times the training of a learned policy in PyTorch and in re4-generative: chunks a second, and the ratio to PyTorch.

    venv/bin/python benches/policy_rate.py [--networks mlp small] [--methods diffusion flow] [--batch 256] [--steps 10] [--rounds 3]
        [--threads 2]

Run it with a Python that has torch 2.9.0. Both sides have the same network (those of tests/policy_reference.py), batch and number of
threads. A step is forward, mean square loss, backward, update by AdamW, and the moving average of the weights. PyTorch repeats it on the
same random inputs; re4-generative also samples windows, noise and times. The programs run in turn, `rounds` times each; the first
five steps of every run only warm up. Medians over all other steps are compared.
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
PROGRAM = ROOT / "target/release/examples/policy_rate"
CHILD = "--pytorch-side"
WARM_UP = 5


def pytorch_side(network: str, method: str, batch: int, steps: int, threads: int) -> None:
    import torch

    sys.path.insert(0, str(ROOT / "tests"))
    import policy_reference as reference

    torch.set_num_threads(threads)
    length = 16 if method == "diffusion" else 1
    model = {"small": reference.UNet, "mlp": reference.Mlp}[network](length)
    average = [parameter.detach().clone() for parameter in model.parameters()]
    optimizer = torch.optim.AdamW(model.parameters(), 3e-4, betas=(0.95, 0.999), weight_decay=1e-6)
    chunks = torch.randn(batch, length, reference.CHANNELS)
    targets = torch.randn(batch, length, reference.CHANNELS)
    condition = torch.randn(batch, reference.CONDITION)
    times = torch.rand(batch)
    seconds = []
    for _ in range(WARM_UP + steps):
        start = time.perf_counter()
        optimizer.zero_grad()
        torch.nn.functional.mse_loss(model(chunks, times, condition), targets).backward()
        optimizer.step()
        with torch.no_grad():
            torch._foreach_lerp_(average, list(model.parameters()), 0.001)
        seconds.append(time.perf_counter() - start)
    print(json.dumps({"seconds": seconds[WARM_UP:]}))


def seconds_of(command: list[str], threads: int) -> list[float]:
    environment = os.environ | {"RAYON_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
    result = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return json.loads(result.stdout)["seconds"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", nargs="+", default=["mlp", "small"], choices=["mlp", "small"])
    parser.add_argument("--methods", nargs="+", default=["diffusion", "flow"], choices=["diffusion", "flow"])
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    own = parser.parse_args()
    build = ["cargo", "build", "--release", "--workspace", "--example", "policy_rate"]
    subprocess.run(build, check=True, cwd=ROOT)
    print("| network | method | PyTorch, chunks/s | re4-generative, chunks/s | ratio |\n|---|---|---|---|---|")
    for network in own.networks:
        for method in own.methods:
            child = [sys.executable, __file__, CHILD, network, method, str(own.batch), str(own.steps), str(own.threads)]
            ours = [str(PROGRAM), "--network", network, "--method", method, "--batch", str(own.batch), "--steps", str(own.steps)]
            times: dict[str, list[float]] = {"pytorch": [], "re4": []}
            for _ in range(own.rounds):
                times["pytorch"] += seconds_of(child, own.threads)
                times["re4"] += seconds_of(ours, own.threads)
            rates = {name: own.batch / statistics.median(all_) for name, all_ in times.items()}
            ratio = rates["re4"] / rates["pytorch"]
            print(f"| `{network}` | {method} | {rates['pytorch']:.0f} | {rates['re4']:.0f} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    if CHILD in sys.argv:
        network, method, *numbers = sys.argv[2:]
        pytorch_side(network, method, *(int(number) for number in numbers))
    else:
        main()
