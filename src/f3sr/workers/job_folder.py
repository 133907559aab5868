"""The job folder that f3sr shares with a worker (docs: workers): files written whole, answers read as hostile.

f3sr writes ``image.png``, what else the kind of job needs, and ``request.json`` last. A worker writes the large file of
an answer and then its JSON document: an answer with a document is done.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.errors import InputError, printable
from f3sr.files import limited_file, strict_json
from f3sr.runtime.cache_files import write_whole
from f3sr.runtime.cache_folder import PRIVATE

PROTOCOL = 1
REQUEST, IMAGE = "request.json", "image.png"
MAX_DOCUMENT_BYTES = 100_000
"""Largest JSON document of an answer."""
STRICT = ConfigDict(strict=True, allow_inf_nan=False, extra="ignore", frozen=True)
Text = Annotated[str, Field(max_length=200)]
Answer = TypeVar("Answer", bound="ModelAnswer")


class ModelAnswer(BaseModel):
    """What every answer tells of the model that gave it."""

    model_config = STRICT
    model: Text = ""
    weights: Text = ""
    licence: Text = ""
    seconds: float = Field(default=0.0, ge=0)

    @property
    def told(self) -> str:
        """Model, revision and licence, for the report."""
        parts = (self.model, self.weights and f"weights {self.weights}", self.licence and f"licence {self.licence}")
        return printable(", ".join(filter(None, parts)))


def is_asked(job: Path) -> bool:
    """Whether the folder has a request already: then it is left as it is."""
    return (job / REQUEST).exists()


def made_folder(folder: Path) -> None:
    """The folder, for this user alone."""
    folder.mkdir(mode=PRIVATE, parents=True, exist_ok=True)


def write_request(job: Path, request: Mapping[str, Any], *, seed: int) -> None:
    """Write ``request.json``, with the protocol's number, the seed and the photo's name."""
    whole = {"protocol": PROTOCOL, "seed": seed, "image": IMAGE, **request}
    write(job / REQUEST, json.dumps(whole, indent=1).encode())


def write(file: Path, data: bytes) -> None:
    """Write a file whole. Raises InputError where there is no room."""
    write_whole(file, data)
    if not file.exists():
        raise InputError(file, found="a place that cannot be written", accepted="a cache folder with room")


def png(pixels: NDArray[Any]) -> bytes:
    """Pixels (H, W) or (H, W, 3 or 4) uint8 as a PNG."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def document(file: Path, kind: type[Answer]) -> Answer:
    """The JSON document of an answer. Raises InputError, naming the file."""
    value = strict_json.read(file, most=MAX_DOCUMENT_BYTES)
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, ", ".join(kind.model_fields))
        raise InputError(file, found=found, accepted=accepted) from error


def large_file(document: Path, name: str, suffix: str, what: str, *, most: int) -> Path:
    """The file beside a document that it names: a bare name, no link, at most so many bytes. Raises InputError."""
    file = document.parent / name
    if Path(name).name != name or not name.lower().endswith(suffix) or file.is_symlink():
        accepted = f"the bare name of {what} in the job folder"
        raise InputError(document, found=f"{suffix.removeprefix('.').upper()} {name!r}", accepted=accepted)
    with limited_file.opened(file, most=most):
        pass
    return file
