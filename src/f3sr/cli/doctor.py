"""doctor: what works on this machine and what does not, each part tried out on something tiny."""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np

import f3sr
from f3sr.backends.kinds import SCENE_GRAPHERS
from f3sr.backends.model_choice import Need
from f3sr.backends.registry import Kind
from f3sr.background.completers import BACKGROUND_COMPLETERS
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.errors import printable
from f3sr.exporters.protocol import EXPORTERS
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS, NORMAL_ESTIMATORS
from f3sr.models.model_endpoint import KEYS
from f3sr.play.languages import LANGUAGES
from f3sr.runtime import kernels
from f3sr.runtime.cache_folder import cache_folder
from f3sr.runtime.machine import usable_cores, usable_memory
from f3sr.segmentation.segmenters import DETECTORS, GROUND_SEGMENTERS, SEGMENTERS

State = Literal["ok", "optional", "limited", "broken", "failed"]

KINDS: tuple[Kind[Any], ...] = (
    *(SEGMENTERS, DETECTORS, GROUND_SEGMENTERS, GEOMETRY_ESTIMATORS, NORMAL_ESTIMATORS),
    *(ASSET_GENERATORS, SCENE_GRAPHERS, BACKGROUND_COMPLETERS, LANGUAGES, EXPORTERS),
)
LITTLE_MEMORY = 4.0
"""Memory [GB] that the largest stated scene, twenty objects of 200,000 triangles, needs."""
LITTLE_DISK = 2.0
"""Free space [GB] below which caches may not fit."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One line of the doctor's answer.

    ``optional`` is absent and not needed, ``limited`` is less than large scenes need, ``broken`` is another package's
    back end that cannot be loaded. Only ``failed`` is something that f3sr needs.
    """

    group: str
    name: str
    state: State
    found: str


def examine() -> list[Check]:
    """Everything there is to know of this installation and machine."""
    return [*_installed(), *_extras(), *_models(), *_parts(), *_backends(), *_machine(), *_caches()]


# --- what is installed --------------------------------------------------------------------------------------------


def _installed() -> Iterator[Check]:
    python = platform.python_version()
    yield _check("installed", "Python", f"{python}, {platform.platform()}", ok=sys.version_info >= (3, 11))
    yield _check("installed", "f3sr", f3sr.__version__)
    for name in _requirements(None):
        version = _version(name)
        yield _check("installed", name, version or "not installed: pip install f3sr", ok=bool(version))


def _extras() -> Iterator[Check]:
    """Which of the optional groups of packages are complete."""
    for extra in metadata.metadata("f3sr").get_all("Provides-Extra") or []:
        absent = [name for name in _requirements(extra) if not _version(name)]
        found = f'without {", ".join(absent)}: pip install "f3sr[{extra}]"' if absent else "complete"
        yield Check(group="extras", name=extra, state="optional" if absent else "ok", found=found)


def _models() -> Iterator[Check]:
    """Whether keys of model providers are set; never which."""
    for provider, variable in KEYS.items():
        there = bool(os.environ.get(variable, "").strip())
        found = f"a key in {variable}" if there else f"no key in {variable}; rules need none"
        yield Check(group="models", name=provider, state="ok" if there else "optional", found=found)


def _requirements(extra: str | None) -> list[str]:
    """Names of the packages that f3sr, or one of its extras, asks for."""
    names: list[str] = []
    for line in metadata.requires("f3sr") or []:
        asked = re.search(r"""extra\s*==\s*['"]([^'"]+)""", line)
        if (asked.group(1) if asked else None) == extra:
            names += re.findall(r"^[\w.-]+", line)
    return names


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


# --- parts tried out ----------------------------------------------------------------------------------------------


def _parts() -> Iterator[Check]:
    yield _check("geometry", "given", "geometry.npz, or depth.png|npy with intrinsics.json")
    yield _tried("assets", "given", _glb_round_trip)
    yield _tried("decomposition", "cuts", _decomposed)
    yield _tried("statics", "HiGHS", _balanced)
    yield _tried("physics", "MuJoCo", _dropped)
    yield _tried("solids", "manifold3d", _united)
    yield _tried("film", "H.264", _filmed)


def _backends() -> Iterator[Check]:
    """Every name of every kind, each tried out; what other packages add is nothing that f3sr needs."""
    for kind in KINDS:
        offers = list(kind.examined())
        if not offers:
            yield Check(group=kind.group, name="none", state="optional", found="no package that adds one is installed")
        for offer in offers:
            missing = [need for need in offer.needs if not need.met]
            state: State = "broken" if offer.problem else "optional" if missing else "ok"
            found = offer.problem or f"from {offer.source}{''.join(map(_told, missing or offer.needs))}"
            yield Check(group=kind.group, name=printable(offer.name) or "unreadable", state=state, found=found)


def _told(need: Need) -> str:
    """One need, and the command that helps where it is not met."""
    return f"; {need.what}: {need.found}{'' if need.met or not need.remedy else f', {need.remedy}'}"


def _tried(group: str, name: str, probe: Callable[[], str]) -> Check:
    """A probe's answer; whatever it raises is the finding."""
    try:
        return _check(group, name, probe())
    except Exception as error:
        return _check(group, name, f"{type(error).__name__}: {error}".splitlines()[0], ok=False)


def _glb_round_trip() -> str:
    from f3sr.io.mesh_files import load_mesh, save_glb

    with tempfile.TemporaryDirectory(prefix="f3sr-doctor-") as folder:
        file = Path(folder, "box.glb")
        save_glb(_l_shape(), file)
        return f"GLB read and written, {len(load_mesh(file).faces)} triangles"


def _decomposed() -> str:
    from f3sr import proxies

    return f"an L in {proxies.split(_l_shape())} parts, in a process of its own"


def _dropped() -> str:
    from f3sr.physics import settling
    from f3sr.scene import SceneObject

    box = _box((0.1, 0.1, 0.1))
    T = np.eye(4)
    T[2, 3] = 0.06
    mask = np.ones((1, 1), bool)
    fallen = settling.settle(
        [SceneObject(id=0, label="", mask_name="", mask=mask, mesh=box, T_world_object=T, parts=_hulls(box))]
    )
    height = fallen.T_world_object[0][2, 3]
    if not fallen.at_rest or abs(height - 0.05) > 1e-3:
        raise RuntimeError(f"a box dropped on the ground ended {1000 * height:.1f} mm high instead of 50")
    return f"{_version('mujoco-core')}, a dropped box came to rest"


def _balanced() -> str:
    from f3sr.contact.linear_programme import LinearProgramme

    load = np.array([3.0])
    found = LinearProgramme(np.array([2.0, 1.0]), np.ones((1, 2)), load, high=2.0).solve()
    if found is None or abs(found.value - 4.0) > 1e-6:
        raise RuntimeError(f"the cheapest two forces for a load of 3 cost {found and found.value} instead of 4")
    return "forces of a linear programme right"


def _united() -> str:
    from f3sr.core.mesh import signed_volume, union

    low, high = _box((0.1, 0.1, 0.1)), _box((0.1, 0.1, 0.1), at=(0.05, 0, 0))
    vertices, faces = union([*_hulls(low), *_hulls(high)])
    volume = signed_volume(vertices, faces)
    if abs(volume - 1.5e-3) > 1e-6:
        raise RuntimeError(f"two half overlapping boxes have {1e3 * volume:.4f} l instead of 1.5")
    return "volume of a union right"


def _filmed() -> str:
    from f3sr.film.video import encode

    video = encode((np.full((16, 16, 3), 80 * k, np.uint8) for k in range(3)), fps=30)
    return f"{video.frames} frames encoded in {len(video.data)} bytes of MP4"


def _box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    part = ConvexPart.hull_of(corners * size + at)
    return Mesh(vertices=part.vertices, faces=part.faces)


def _l_shape() -> Mesh:
    from f3sr.core.mesh import union

    vertices, faces = union([*_hulls(_box((0.2, 0.1, 0.05))), *_hulls(_box((0.05, 0.1, 0.2), at=(-0.075, 0, 0.075)))])
    return Mesh(vertices=vertices, faces=faces)


def _hulls(mesh: Mesh) -> tuple[ConvexPart, ...]:
    return (mesh.hull,)


# --- the machine --------------------------------------------------------------------------------------------------


def _machine() -> Iterator[Check]:
    yield _check("machine", "cores", f"{usable_cores()} of {os.cpu_count()}")
    memory = usable_memory()
    found = f"{memory:.1f} GB" + ("" if memory >= LITTLE_MEMORY else f", large scenes need {LITTLE_MEMORY:.0f}")
    yield Check(group="machine", name="memory", state="ok" if memory >= LITTLE_MEMORY else "limited", found=found)
    yield _space("temporary files", Path(tempfile.gettempdir()))


def _caches() -> Iterator[Check]:
    root = cache_folder()
    if root is None:
        found = "none that this user alone can write to; every run compiles its kernels"
        yield Check(group="cache", name="folder", state="limited", found=found)
        return
    yield _space("folder", root, group="cache")
    compiled = (
        "compiled" if kernels.is_warm() else "not all compiled yet: the first run and film take some ten seconds longer"
    )
    yield _check("cache", "kernels", compiled)
    for name in ("stages", "proxies", "workers", "hosted"):
        files = [f for f in (root / name).rglob("*") if f.is_file()]
        yield _check("cache", name, f"{len(files)} files, {sum(f.stat().st_size for f in files) / 1e6:.0f} MB")


def _space(name: str, folder: Path, *, group: str = "machine") -> Check:
    free = shutil.disk_usage(folder).free / 1e9
    found = f"{folder}, {free:.1f} GB free" + ("" if free >= LITTLE_DISK else ", which is little")
    return Check(group=group, name=name, state="ok" if free >= LITTLE_DISK else "limited", found=found)


def _check(group: str, name: str, found: str, *, ok: bool = True) -> Check:
    return Check(group=group, name=name, state="ok" if ok else "failed", found=found)
