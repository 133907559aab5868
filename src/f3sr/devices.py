"""Where the questions of alignment's searches are answered: on the processor, or all at once on a GPU through torch."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import metadata
from typing import Literal, TypeVar

import numpy as np

from f3sr.contour import Integrals
from f3sr.errors import InputError
from f3sr.frames import Array, Camera, pose
from f3sr.freedom import ObjectFreedom
from f3sr.report import Decision
from f3sr.searches import answered, together
from f3sr.silhouette import Surface, Target
from f3sr.silhouette_fit import FitSearch, ObjectFit, one_by_one

R = TypeVar("R")

Device = Literal["auto", "cpu", "cuda", "torch-cpu"]
TorchDevice = Literal["cuda", "torch-cpu"]

CUDA_DRIVER = "libcuda.so.1"
"""The library that comes with NVIDIA's driver."""
MOST_THREADS = 8

Answers = Callable[[Sequence[tuple[ObjectFit, Array]]], Sequence[Integrals]]


class DeviceError(Exception):
    """A device does not work here; the message says why."""


@dataclass(frozen=True, kw_only=True)
class Opened:
    """A device that has shown that it works."""

    name: str
    answers: Answers


def results_of(searches: Iterable[FitSearch[R]], device: Device) -> tuple[list[R], list[Decision]]:
    """What searches found, in their order, and what the report should say of where that was computed.

    ``cpu`` is the compiled kernels, ``cuda`` torch on a GPU, ``torch-cpu`` torch on the processor, slower than the
    kernels and there to check them; ``auto`` is cuda where it works, else cpu. A device that was asked for and does not
    work is an InputError. Where ``auto`` finds a GPU that does not work, or that fails on the way, the kernels take
    over and a Decision says so.

    Devices agree to rounding, so each one's result is a valid result of the stage. The keys of stored results hold this
    setting and nothing of the machine: what named devices made is never taken for one another's, while ``auto`` asks
    for no particular one and may resume what a GPU computed elsewhere. The Decision stored with it says which that was.
    """
    if device == "cpu" or (device == "auto" and why_no_cuda()):
        return _in_threads(searches), []
    try:
        opened = open_torch("cuda" if device == "auto" else device)
    except DeviceError as error:
        if device != "auto":
            raise _unusable(device, str(error)) from error
        return _in_threads(searches), [_fallback(str(error))]
    answers = _Guarded(opened.answers, device)
    found = answered(together(searches), answers)
    used = Decision(choice=f"objects: silhouettes computed on {opened.name}", reason=f'device = "{device}"')
    return found, [used, *([_fallback(answers.failure)] if answers.failure else [])]


def _in_threads(searches: Iterable[FitSearch[R]]) -> list[R]:
    """Each search in a thread of its own: the kernels release the GIL."""

    def result(search: FitSearch[R]) -> R:
        return answered(search, one_by_one)

    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
        return list(pool.map(result, searches))


class _Guarded:
    """The answers of a device; of the kernels from its first failure on, where no device was asked for."""

    def __init__(self, answers: Answers, device: Device) -> None:
        self.answers = answers
        self.device: Device = device
        self.failure: str | None = None

    def __call__(self, questions: Sequence[tuple[ObjectFit, Array]]) -> Sequence[Integrals]:
        if self.failure is None:
            try:
                return self.answers(questions)
            except RuntimeError as error:  # torch's errors of memory and of devices
                self.failure = _said(error)
                if self.device != "auto":
                    raise _unusable(self.device, self.failure) from error
        return one_by_one(questions)


def _fallback(why: str) -> Decision:
    return Decision(choice="objects: silhouettes computed on the CPU", reason=f"the GPU failed: {why}", fallback=True)


def require(device: Device, setting: str) -> None:
    """Refuse a device that was asked for by a ``setting`` and plainly cannot work here, before any work starts."""
    why = {"cuda": why_no_cuda, "torch-cpu": why_no_torch}.get(device, lambda: None)()
    if why:
        raise _unusable(device, why, setting)


def _unusable(device: Device, why: str, setting: str = "align.device") -> InputError:
    return InputError(setting, found=f'"{device}", but {why}', accepted='"auto", "cpu", or what f3sr doctor finds able')


# --- devices of torch ---------------------------------------------------------------------------------------------


def why_no_torch() -> str | None:
    """What keeps torch from being used, None if nothing does; nothing is imported."""
    return None if _torch_version() else 'torch is not installed: pip install "f3sr[torch]"'


def why_no_cuda() -> str | None:
    """What keeps torch from using a GPU, as far as can be told without the seconds of importing torch; None if nothing
    does."""
    version = _torch_version()
    if not version:
        return why_no_torch()
    if version.endswith("+cpu"):
        return f"torch {version} is built without CUDA"
    if os.environ.get("CUDA_VISIBLE_DEVICES") in ("", "-1"):
        return "CUDA_VISIBLE_DEVICES hides all GPUs"
    if not _has_driver():
        return f"there is no NVIDIA driver ({CUDA_DRIVER})"
    return None


def _torch_version() -> str | None:
    try:
        return metadata.version("torch")
    except metadata.PackageNotFoundError:
        return None


def _has_driver() -> bool:
    try:
        ctypes.CDLL(CUDA_DRIVER)
    except OSError:
        return False
    return True


def open_torch(device: TorchDevice) -> Opened:
    """A device of torch, tried out. Raises DeviceError with the reason where it does not work."""
    if why := why_no_torch() if device == "torch-cpu" else why_no_cuda():
        raise DeviceError(why)
    try:
        from f3sr.torch_twin.integrals import TorchIntegrals, name_of

        place = "cpu" if device == "torch-cpu" else "cuda"
        opened = Opened(name=name_of(place), answers=TorchIntegrals(place))
        found = opened.answers([(_triangle(), np.zeros(6))])
    except (ImportError, OSError, RuntimeError, AssertionError) as error:  # AssertionError: built without CUDA
        raise DeviceError(_said(error)) from error
    if not _agree(found[0], _triangle().integrals(np.zeros(6))):
        raise DeviceError(f"{opened.name} computes wrong values")
    return opened


def _said(error: Exception) -> str:
    """An error of torch in one line."""
    return " ".join(f"{type(error).__name__}: {error}".splitlines()[:1])


def _agree(a: Integrals, b: Integrals) -> bool:
    pairs = ((a.value, b.value), (a.gradient, b.gradient), (a.curvature, b.curvature))
    return all(np.allclose(x, y, rtol=1e-6, atol=1e-6) for x, y in pairs)


def _triangle() -> ObjectFit:
    """A fit that takes no time."""
    camera = Camera(width=8, height=8, K=np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), T_world_camera=pose())
    corners = np.array([[-0.3, -0.3, 1.0], [0.35, -0.1, 1.1], [0.1, 0.4, 1.2]])
    surface = Surface.of([(corners, np.array([[0, 1, 2]], np.int32))])
    freedom = ObjectFreedom(anchor=corners.mean(0), basis=np.eye(3)[:, :2], reach=np.full(6, 0.1))
    target = Target.of(surface.silhouette(camera))
    return ObjectFit(surface=surface, camera=camera, target=target, freedom=freedom, prior=np.zeros(6))
