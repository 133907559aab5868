"""The time of one whole ``f3sr reconstruct``: with only the kernels compiled, with collision proxies, with everything.

Kernels are compiled in all cases: that happens once per machine and version, proxies once per mesh, stages once per
input, configuration and code.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import caches
import process


def cold_and_warm(folder: Path, out: Path) -> dict[str, process.Finished]:
    """Reconstruct three times: cold, with warm proxies, and resumed from the stored stages."""
    kernels, _ = caches.kept(out / "warm_up.log")
    with caches.fresh(kernels) as cache:
        environment = {"F3SR_CACHE_DIR": str(cache)}
        cold = process.reconstruct(folder, out / "cold", environment=environment)
        shutil.rmtree(cache / "stages", ignore_errors=True)
        warm = process.reconstruct(folder, out / "warm", environment=environment)
        resumed = process.reconstruct(folder, out / "resumed", environment=environment)
    return {"cold": cold, "warm": warm, "resumed": resumed}
