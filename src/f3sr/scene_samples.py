"""sample: scenes that the photo of a package may show as well, each at rest, as a package of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from f3sr.contact_retries import ContactRetries
from f3sr.core.transforms import Array
from f3sr.errors import InputError, require_kind
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.runtime.machine import one_thread
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.scene import names_of
from f3sr.scene_package.package import Package
from f3sr.uncertainty.sampling import Rejected, Sample, SamplingConfig, draw

MOST_SAMPLES = 10_000
"""Samples of one call."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawn:
    """One sample, and how many scenes were tried for it; ``rejected`` says why the others were not kept."""

    sample: Sample
    rejected: tuple[Rejected, ...]


def sample_scenes(
    package: Package,
    count: int = 20,
    *,
    seed: int = 0,
    config: SamplingConfig | None = None,
    progress: Progress = silent,
) -> Iterator[Drawn]:
    """Draw scenes that the photo of a package may show as well (docs: uncertainty); equal arguments, equal scenes.

    Every one meets the masks (mIoU_visible at most .01 lower), crosses nowhere and rests. Poses come from the
    posterior in scene.json, with contact and masks as constraints. Fewer than ``count`` come where most that are tried
    fall. Raises InputError for a package without uncertainties.
    """
    require_kind("package", package, Package, accepted="f3sr.read_package(...)")
    require_count("count", count)
    require_kind("seed", seed, Integral, accepted="0 or more")
    if seed < 0:
        raise InputError("seed", found=str(seed), accepted="0 or more")
    covariances = {id: np.array(u.conditional) for id, u in package.uncertainty.items()}
    if all(o.mobility == "fixed" for o in package.scene):
        found = f"only fixed objects: {names_of(sorted(o.id for o in package.scene))}"
        raise InputError(package.folder / "scene.json", found=found, accepted="an object that may move")
    if not covariances:
        raise InputError(
            package.folder / "scene.json",
            found="no uncertainty of any pose",
            accepted="a package of `f3sr reconstruct` without --skip uncertainty",
        )
    return _drawn(package, count, seed, covariances, config or SamplingConfig(), progress)


def require_count(option: str, count: int) -> None:
    """Raise InputError, which names the ``option``, for no number of samples."""
    require_kind(option, count, Integral, accepted=(accepted := f"from 1 to {MOST_SAMPLES:,}"))
    if not 1 <= count <= MOST_SAMPLES:
        raise InputError(option, found=str(count), accepted=accepted)


def _drawn(
    package: Package,
    count: int,
    seed: int,
    covariances: Mapping[int, Array],
    config: SamplingConfig,
    progress: Progress,
) -> Iterator[Drawn]:
    retries = ContactRetries(config=with_shared_settings(Config()))
    scenes = draw(package.scene, covariances, retries.settled, config, seed=seed)
    tries = config.attempts * count
    for k in range(count):
        sample, rejected = None, list[Rejected]()
        with timed(f"sample {k + 1} of {count}", progress):
            while tries and sample is None:
                tries -= 1
                with one_thread():
                    found = next(scenes)
                if isinstance(found, Rejected):
                    rejected.append(found)
                else:
                    sample = found
        if sample is None:
            return
        yield Drawn(sample=sample, rejected=tuple(rejected))
