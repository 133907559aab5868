"""Networks of TorchScript files. Such a file is a program: it is run only where the user names a local file, never one
of the hub."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from f3sr.errors import InputError, one_line
from f3sr.neural.model_loading import LocalModel, torch_library
from f3sr.neural.model_source import Weights, find_file


class TorchScriptModel(LocalModel):
    """A back end of one local file, ``NAME:FILE``."""

    script: ClassVar[tuple[str, str]]
    """The back end's name, and a file as its authors call it."""

    def weights(self) -> Weights:
        """The file. Raises InputError unless it is a local one."""
        name, usual = self.script
        if not self.name or not Path(self.name).expanduser().is_file():
            accepted = f"{name}:FILE, a local TorchScript file such as {usual}, which you trust: it is a program"
            raise InputError(name, found=self.name or "no file", accepted=accepted)
        return find_file(self.name, file="", title=self.family.title, allow_downloads=False)

    def network(self) -> Any:
        """The program on its device. Raises InputError for a file of another kind."""
        return self.loaded(self._read)

    def _read(self, weights: Weights) -> Any:
        torch = torch_library(self.family.title)
        try:
            return torch.jit.load(str(weights.path), map_location="cpu")
        except (OSError, ValueError, RuntimeError) as error:
            found = one_line(f"{type(error).__name__}: {error}")
            raise InputError(
                weights.path, found=found, accepted=f"a TorchScript file of {self.family.title}"
            ) from error
