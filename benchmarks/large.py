"""Large inputs: time, peak memory of the whole process tree and where both go, by stage.

usage: python benchmarks/large.py [CASE ...] [--data FOLDER] [--out FOLDER]
Cases: 20 (the issue's: 20 objects of 200k triangles with 2k textures on a 4000x3000 photo), 5 (its first five),
many (60 small objects), photo (the bundled example's ten on 95 megapixels). Each is run cold, then with its proxies.
Inputs are made from a seed, kept under --data and never committed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import caches
import memory

HERE = Path(__file__).resolve().parent
CASES = {
    "20": {"objects": 20, "faces": 200_000, "texture": 2048, "width": 4000, "height": 3000},
    "5": {"objects": 5, "faces": 200_000, "texture": 2048, "width": 4000, "height": 3000},
    "many": {"objects": 60, "faces": 4000, "texture": 512, "width": 1600, "height": 1200},
    "photo": {"enlarged": 11},
}
STAGES = (
    *("assemble", "level", "align", "relate", "decompose", "separate", "settle", "close", "refine", "describe"),
    *("evaluate", "inpaint"),
)
LIMIT_MB = 4000


def main() -> int:
    args = _arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    kernels, _ = caches.kept(args.out / "warm_up.log")
    failed = False
    for name in args.cases or ["20"]:
        folder = made(args.data, CASES[name])
        print(f"\n## {name}: {json.dumps(CASES[name])}, input {size_of(folder) / 1e6:.0f} MB", flush=True)
        with caches.fresh(kernels) as cache:
            for warmth in ("cold",) if args.cold else ("cold", "proxies known"):
                shutil.rmtree(cache / "stages", ignore_errors=True)
                failed |= not measured(folder, args.out / name, cache, warmth)
    return int(failed)


def made(data: Path, case: dict[str, Any]) -> Path:
    """The input folder of a case. It is written by another process: our own memory would count as its children's."""
    folder = data / "_".join(map(str, case.values()))
    subprocess.run([sys.executable, HERE / "large_scene.py", folder, json.dumps(case)], check=True)
    return folder


def measured(folder: Path, out: Path, cache: Path, warmth: str) -> bool:
    """Reconstruct once and print what it took; whether that ended well and within the limit."""
    command = [sys.executable, "-m", "f3sr", "reconstruct", str(folder)]
    building = out.with_name(f".{out.name}.building")
    seen = memory.watch(
        [*command, "-o", str(out), "--overwrite"],
        environment={"F3SR_CACHE_DIR": str(cache)},
        marks={"package": building.exists},
    )
    log = out.with_suffix(".log")
    log.write_text("".join(f"{t:8.2f} {line}\n" for t, line in seen.lines))
    out.with_suffix(".samples.json").write_text(json.dumps([vars(s) for s in seen.samples]))
    peak = max(s.tree for s in seen.samples)
    print(f"\n{warmth}: {seen.wall:.0f} s, {seen.cpu:.0f} s of processor time, exit code {seen.code}")
    print(f"peak: {peak:.0f} MB of the whole process tree, {seen.highest:.0f} MB of the first process")
    if seen.code:
        print("\n".join(line for _, line in seen.lines[-3:]))
        return False
    for name, start, end in phases(seen):
        print(f"  {name:10} {end - start:7.1f} s {seen.busy(start, end):7.1f} s cpu {seen.peak(start, end):7.0f} MB")
    print(f"package: {size_of(out) / 1e6:.0f} MB ({', '.join(parts_of(out))})")
    table = [line for _, line in seen.lines if re.match(r"(mIoU|PSNR|R_pen|K_max|D_max|gap|below|inside|proxy)", line)]
    print("\n".join(table), flush=True)
    return peak <= LIMIT_MB


def phases(seen: memory.Watched) -> list[tuple[str, float, float]]:
    """Name, start and end [s] of all that the command does one after the other."""
    found: list[tuple[str, float, float]] = []
    at = 0.0
    for time, line in seen.lines:
        name = next((stage for stage in STAGES if re.search(rf"\b{stage}\b.*\d s$", line)), None)
        if name is None:
            continue
        if not found:  # the first stage tells its own time; reading and imports come before
            began = max(at, time - float(line.split()[-2]))
            found.append(("read", at, began))
            at = began
        found.append((name, at, time))
        at = time
    package = seen.marks.get("package", at)
    return [*found, ("pictures", at, package), ("package", package, seen.wall)]


def size_of(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def parts_of(folder: Path) -> list[str]:
    """The largest parts of a package with their sizes."""
    sizes = {p.name: size_of(p) if p.is_dir() else p.stat().st_size for p in folder.iterdir()}
    return [f"{name} {size / 1e6:.0f}" for name, size in sorted(sizes.items(), key=lambda s: -s[1])[:6]]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="*", choices=CASES, metavar="CASE", help=f"20 by default, {', '.join(CASES)}")
    temporary = Path(tempfile.gettempdir()) / f"f3sr-large-{os.getuid()}"
    parser.add_argument("--data", type=Path, default=temporary / "inputs", help="made inputs are kept here")
    parser.add_argument("--out", type=Path, default=temporary / "out", help="packages, logs and samples")
    parser.add_argument("--cold", action="store_true", help="leave out the run with known proxies")
    args = parser.parse_args()
    args.data, args.out = args.data.resolve(), args.out.resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
