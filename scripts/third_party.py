"""Prints the licences of everything that is compiled into the wheel, for distribution with it: crates, HDF5 and Chipmunk.

    python3 scripts/third_party.py      (in the root of the repository, after the crates were fetched)

Crates with the same licence text are listed together.
"""

import json
import subprocess
from pathlib import Path

TREE = "cargo tree --locked -p re4-pipe -p re4-python --no-default-features --features re4-pipe/static-hdf5,re4-python/static-hdf5"
NAMES = ("license", "licence", "copying", "notice", "unlicense")
CHIPMUNK = Path("/usr/share/doc/libchipmunk-dev/copyright")


def output(call: list[str]) -> str:
    return subprocess.run(call, capture_output=True, text=True, check=True).stdout


def texts(folder: Path) -> str:
    """The licence files of a package, joined; HDF5's is in the package that contains its source."""
    found = [file for file in folder.iterdir() if file.name.lower().startswith(NAMES)]
    files = sorted(file for file in [*found, folder / "ext/hdf5/LICENSE"] if file.is_file())
    return "\n\n".join(file.read_text(errors="replace").strip() for file in files)


def main() -> None:
    tree = output([*TREE.split(), "--edges", "normal", "--prefix", "none", "--format", "{p}"])
    linked = {" ".join(line.split()[:2]) for line in tree.splitlines()}
    packages = json.loads(output(["cargo", "metadata", "--format-version", "1", "--locked", "--all-features"]))["packages"]
    by_text: dict[str, list[str]] = {}
    for package in packages:
        if package["source"] and f"{package['name']} v{package['version']}" in linked:
            text = texts(Path(package["manifest_path"]).parent) or f"License: {package['license']}"
            by_text.setdefault(text, []).append(f"{package['name']} {package['version']} ({package['license'] or 'see below'})")
    by_text.setdefault(CHIPMUNK.read_text(), []).append("Chipmunk 7 (MIT)")
    print("re4-pipe contains the following software.")
    for text, names in sorted(by_text.items(), key=lambda entry: entry[1]):
        print("\n" + "=" * 80, "\n".join(names), "", text, sep="\n")


if __name__ == "__main__":
    main()
