"""Models in memory: device and precision chosen, loaded once for many photos, told in provenance."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import metadata
from typing import Any, ClassVar

from f3sr.backends.model_choice import Device, ModelChoice, Need, Precision
from f3sr.errors import F3srError, InputError, one_line
from f3sr.neural.model_source import HUB_NAME, Weights, fetch_command, find_folder
from f3sr.runtime.extras import library
from f3sr.runtime.machine import usable_memory

EXTRA = "models"
REMEDY = "pip install 'f3sr[models]'"
PACKAGES = {"torch": REMEDY, "transformers": REMEDY}
KEPT = 4
"""Most models that stay in memory: a detector, a segmenter, a geometry and one more."""

_loaded: dict[tuple[object, ...], Any] = {}
_lock = threading.RLock()


@dataclass(frozen=True, kw_only=True)
class ModelFamily:
    """Models that one back end can run."""

    title: str
    """What messages call it."""
    types: tuple[str, ...] = ()
    """``model_type`` of the configurations that it reads."""
    default: str = ""
    """Name on the hub of the model that runs where the user names none."""
    gigabytes: float = 1.0
    """Memory that the default model needs at float32, with a photo [GB]; measured on none, by its parameters."""
    usual: Precision = "float32"
    """Precision of ``auto`` on a GPU."""
    packages: Mapping[str, str] = field(default_factory=lambda: dict(PACKAGES))
    """Packages that it imports, and the commands that install them."""


class LocalModel:
    """What all back ends of this folder have: a choice of weights, device and precision, needs and provenance.

    A subclass names its ``family`` and loads by ``loaded``. Construction reads no file."""

    takes_model: ClassVar[bool] = True
    family: ClassVar[ModelFamily]

    def __init__(self, choice: ModelChoice | None = None) -> None:
        self.choice = choice or ModelChoice()

    @property
    def name(self) -> str:
        """The weights' name."""
        return self.choice.model or self.family.default

    def weights(self) -> Weights:
        """Where the weights are. Raises InputError."""
        return find_folder(
            self.name,
            types=self.family.types,
            title=self.family.title,
            allow_downloads=self.choice.allow_downloads,
        )

    def loaded(self, make: Callable[[Weights], Any], part: str = "") -> Any:
        """The model on its device, made by ``make`` unless it is in memory already."""
        weights = self.weights()
        device, precision = self.place()
        key = (type(self).__name__, part, str(weights.path), weights.revision, device, precision)
        with _lock:
            model = _loaded.pop(key) if key in _loaded else make(weights).to(device).eval()
            _loaded[key] = model
            while len(_loaded) > KEPT:
                del _loaded[next(iter(_loaded))]
        return model

    def transformer(self, name: str) -> Any:
        """A model class of transformers with these weights, in inference mode."""
        return self.loaded(lambda weights: transformers_model(name, weights, self.dtype()), name)

    def place(self) -> tuple[str, Precision]:
        """Device and precision that the choice comes to. Raises InputError for a device that is not there."""
        torch = torch_library(self.family.title)
        device = chosen_device(torch, self.choice.device)
        precision = self.choice.precision
        if precision == "auto":
            precision = self.family.usual if device == "cuda" else "float32"
        return device, precision

    def dtype(self) -> Any:
        """torch's type of the precision."""
        return getattr(torch_library(self.family.title), self.place()[1])

    @property
    def provenance(self) -> Mapping[str, str]:
        """Weights, revision, licence, device and precision; of absent weights the name alone."""
        try:
            weights = _without_downloads(self).weights()
            device, precision = self.place()
        except F3srError:
            return {"weights": self.name}
        return {
            "weights": weights.name,
            "revision": weights.revision,
            "licence": weights.licence,
            "device": device,
            "precision": precision,
        }

    def needs(self) -> tuple[Need, ...]:
        """Packages, weights and memory."""
        packages = tuple(_package(name, remedy) for name, remedy in self.family.packages.items())
        if not all(need.met for need in packages):
            return packages
        return (*packages, self._weights_need(), self._memory_need())

    def _weights_need(self) -> Need:
        try:
            weights = _without_downloads(self).weights()
        except F3srError:
            remedy = fetch_command(self.name) if HUB_NAME.fullmatch(self.name) else ""
            found = f"none of {self.name}" if self.name else "none; name a file as NAME:FILE"
            return Need(what="weights", met=False, found=found, remedy=remedy)
        return Need(what="weights", met=True, found=f"{weights.name} {weights.revision[:23]}, {weights.licence}")

    def _memory_need(self) -> Need:
        torch = torch_library(self.family.title)
        device = chosen_device(torch, self.choice.device)
        there = torch.cuda.mem_get_info()[0] / 1e9 if device == "cuda" else usable_memory()
        found = f"{there:.1f} GB on {device}, about {self.family.gigabytes:g} needed"
        return Need(what="memory", met=there >= self.family.gigabytes, found=found, remedy="a smaller model")


def chosen_device(torch: Any, device: Device) -> str:
    """``auto`` is the first of cuda, mps and cpu that is there. Raises InputError for one that is not."""
    there = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available(), "cpu": True}
    available = [name for name, is_there in there.items() if is_there]
    if device != "auto" and device not in available:
        raise InputError("--device", found=device, accepted=f"auto, {', '.join(available)}: what this machine has")
    return available[0] if device == "auto" else device


def torch_library(title: str) -> Any:
    """torch, or F3srError naming the extra."""
    return library("torch", extra=EXTRA, why=title)


def transformers_library(title: str) -> Any:
    """transformers without its progress bars, or F3srError naming the extra."""
    transformers = library("transformers", extra=EXTRA, why=title)
    transformers.utils.logging.disable_progress_bar()
    return transformers


def transformers_model(name: str, weights: Weights, dtype: Any) -> Any:
    """A model class of transformers with all its weights, from safetensors; never code of a repository.

    Raises InputError for files that cannot be read or lack tensors of the model."""
    made, torch = _class(name), torch_library(name)
    damaged = library("safetensors", extra=EXTRA, why=name).SafetensorError
    try:
        model, info = made.from_pretrained(
            str(weights.path),
            dtype=dtype,
            local_files_only=True,
            trust_remote_code=False,
            use_safetensors=True,
            output_loading_info=True,
        )
    except torch.OutOfMemoryError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, damaged) as error:
        found = one_line(f"{type(error).__name__}: {error}")
        raise InputError(weights.path, found=found, accepted=f"the weights of a {name}") from error
    missing = sorted(info["missing_keys"])
    if missing:
        found = f"weights without {len(missing)} of the model's tensors, {missing[0]} among them"
        raise InputError(weights.path, found=found, accepted=f"all tensors of a {name}")
    return model


def transformers_part(name: str, weights: Weights, **more: Any) -> Any:
    """A tokenizer or an image processor of the weights' folder. Raises InputError where its files are absent."""
    made = _class(name)
    try:
        return made.from_pretrained(str(weights.path), local_files_only=True, trust_remote_code=False, **more)
    except (OSError, ValueError, KeyError, TypeError, ImportError) as error:
        found = one_line(f"{type(error).__name__}: {error}")
        raise InputError(weights.path, found=found, accepted=f"files that {name} reads") from error


def _class(name: str) -> Any:
    """A class of transformers. Raises F3srError where a package that it imports does not fit torch."""
    try:
        return getattr(transformers_library(name), name)
    except (ImportError, RuntimeError, AttributeError) as error:
        why = f"{type(error).__name__}: {error}"
        raise F3srError(
            f"transformers' {name} cannot be imported ({one_line(why)}): f3sr needs transformers 5.20 or later and no "
            "torchvision; pip uninstall torchvision helps where it was built for another torch"
        ) from error


def _without_downloads(model: LocalModel) -> LocalModel:
    return type(model)(replace(model.choice, allow_downloads=False))


def _package(name: str, remedy: str) -> Need:
    there = importlib.util.find_spec(name) is not None
    try:
        found = metadata.version(name) if there else "not installed"
    except metadata.PackageNotFoundError:
        found = "installed"
    return Need(what=f"package {name}", met=there, found=found, remedy="" if there else remedy)
