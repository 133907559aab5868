"""Where the weights of a model are: a local file or folder, or a repository of the hub that was fetched before.

Nothing is fetched unless the user allows it. Only weights without code are accepted: safetensors, or a file that the
user names.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from f3sr.errors import F3srError, InputError, one_line
from f3sr.files import strict_json
from f3sr.runtime.extras import library

HUB_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*")
"""OWNER/NAME of a repository on the hub."""
CONFIG, CARD = "config.json", "README.md"
FETCHED = ("*.json", "*.txt", "*.safetensors", CARD)
"""What is fetched of a repository: never pickles, never code."""
PICKLES = ("*.bin", "*.pt", "*.pth", "*.ckpt")
MAX_CARD = 1_000_000
"""Most characters of a model card that are read."""
DIGITS = 16
"""Digits of a sha256 that reports show."""
LICENCES: Mapping[str, str] = {
    "facebook/sam2": "apache-2.0",
    "facebook/sam3": "SAM License",
    "IDEA-Research/grounding-dino": "apache-2.0",
    "google/owlv2": "apache-2.0",
    "tue-mps/": "mit",
    "depth-anything/Depth-Anything-V2-Small": "apache-2.0",
    "depth-anything/Depth-Anything-V2-Metric-Indoor-Small": "apache-2.0",
    "depth-anything/Depth-Anything-V2-Metric-Outdoor-Small": "apache-2.0",
    "depth-anything/Depth-Anything-V2": "cc-by-nc-4.0",
    "apple/DepthPro": "apple-amlr",
    "Intel/dpt-large": "apache-2.0",
    "Ruicheng/moge": "mit",
}
"""Licences by the beginning of a hub name, the longest that fits; a model card goes first."""


@dataclass(frozen=True, kw_only=True)
class Weights:
    """The weights of a model on this machine."""

    name: str
    """As the user or the hub calls them."""
    path: Path
    """Their folder or file."""
    revision: str
    """Commit of the hub's repository, or sha256 of the local weight files."""
    licence: str
    """As its card or LICENCES has it; "unknown" where neither does."""


def find_folder(name: str, *, types: Sequence[str], title: str, allow_downloads: bool) -> Weights:
    """A folder of a transformers model of one of some ``types``, as ``config.json`` names them.

    Raises InputError where it is absent, of another type, or holds no safetensors; F3srError where a download fails.
    """
    path = _local(name) or _snapshot(name, allow_downloads=allow_downloads)
    accepted = f"a folder of {title} weights with {CONFIG} and *.safetensors"
    if not path.is_dir():
        raise InputError(path, found="a file", accepted=accepted)
    config = path / CONFIG
    if not config.is_file():
        names = ", ".join(sorted(p.name for p in path.iterdir())[:6]) or "an empty folder"
        raise InputError(path, found=f"no {CONFIG} ({names})", accepted=accepted)
    described: Any = strict_json.read(config, accepted=f"{CONFIG} of a transformers model")
    kind = described.get("model_type") if isinstance(described, dict) else None
    if kind not in types:
        raise InputError(config, found=f"model_type {kind!r}", accepted=f"{' or '.join(types)}, that is, {title}")
    files = sorted(path.glob("*.safetensors"))
    if not files:
        pickles = ", ".join(p.name for pattern in PICKLES for p in path.glob(pattern))
        found = f"{pickles}, which may run code when it is read" if pickles else "no weights"
        raise InputError(path, found=found, accepted="*.safetensors")
    return _weights(name, path, path, files)


def find_file(name: str, *, file: str, title: str, allow_downloads: bool) -> Weights:
    """A checkpoint: a local file, or ``file`` in a local folder or in a repository of the hub. Raises likewise."""
    path = _local(name) or _snapshot(name, allow_downloads=allow_downloads, patterns=(file, CARD))
    folder = path if path.is_dir() else path.parent
    path = path / file if path.is_dir() else path
    if not path.is_file():
        raise InputError(folder, found=f"no {file}", accepted=f"a {title} checkpoint, or a folder with {file}")
    return _weights(name, path, folder, [path])


def _local(name: str) -> Path | None:
    """The place on this machine, or None for a name of the hub."""
    path = Path(name).expanduser()
    if path.exists():
        return path.resolve()
    if HUB_NAME.fullmatch(name):
        return None
    raise InputError("model", found=f"{name!r}, which does not exist", accepted="a local file or folder, or OWNER/NAME")


def _snapshot(name: str, *, allow_downloads: bool, patterns: Sequence[str] = FETCHED) -> Path:
    """The folder of a hub's repository in the local cache, fetched first where that is allowed."""
    hub = library("huggingface_hub", extra="models", why="a model of the hub")
    errors = library("huggingface_hub.errors", extra="models", why="a model of the hub")
    try:
        folder = hub.snapshot_download(name, allow_patterns=list(patterns), local_files_only=not allow_downloads)
    except (errors.LocalEntryNotFoundError, errors.OfflineModeIsEnabled) as error:
        if allow_downloads:
            raise F3srError(
                f"{name}: cannot be downloaded ({type(error).__name__}); is this machine online?"
            ) from error
        raise InputError(
            "model",
            found=f"no weights of {name} on this machine",
            accepted=f"a local folder, {fetch_command(name)}, or --allow-downloads",
        ) from error
    except (OSError, ValueError, errors.HfHubHTTPError) as error:
        raise F3srError(one_line(f"{name}: cannot be downloaded ({type(error).__name__}: {error})")) from error
    return Path(folder)


def fetch_command(name: str) -> str:
    """The command that fetches a repository of the hub."""
    return f"hf download {name}"


def _weights(name: str, path: Path, folder: Path, files: Sequence[Path]) -> Weights:
    commit = folder.name if folder.parent.name == "snapshots" else ""
    revision = commit or _digest(tuple((str(f), f.stat().st_size, f.stat().st_mtime_ns) for f in files))
    return Weights(name=name, path=path, revision=revision, licence=_licence(name, folder))


@lru_cache(maxsize=64)
def _digest(files: tuple[tuple[str, int, int], ...]) -> str:
    """sha256 of some files; size and time are only the key under which it is kept."""
    hashed = hashlib.sha256()
    for file, _, _ in files:
        with Path(file).open("rb") as opened:
            while block := opened.read(1 << 20):
                hashed.update(block)
    return f"sha256:{hashed.hexdigest()[:DIGITS]}"


def _licence(name: str, folder: Path) -> str:
    """Of the front matter of the model card, else by the hub's name."""
    card = folder / CARD
    text = card.read_text(errors="replace")[:MAX_CARD] if card.is_file() else ""
    front = re.match(r"---\s*\n(.*?)\n---", text, re.DOTALL)
    told = dict(re.findall(r"^(license|license_name):[ \t]*['\"]?([^'\"\n]+)", front[1], re.MULTILINE)) if front else {}
    if told.get("license"):
        return (told.get("license_name") or told["license"]).strip()
    fitting = [start for start in LICENCES if name.startswith(start)]
    return LICENCES[max(fitting, key=len)] if fitting else "unknown"
