"""Implementations by kind and name: built-in ones from a table, third parties' from entry points, imported on use.

A third party's package declares ``[project.entry-points."f3sr.KIND"] NAME = "module:attribute"``. The attribute is
called without arguments and returns the implementation. Where it has a true ``takes_model``, it is called with a
ModelChoice: such an implementation is asked for as ``NAME`` or ``NAME:MODEL``. What one package does wrong breaks no
other name.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, Self, TypeVar, cast

import f3sr
from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.errors import F3srError, InputError, one_line, require_kind, unforeseen

P = TypeVar("P")
T = TypeVar("T")


class BackendError(F3srError):
    """An implementation that cannot be loaded, or that raised instead of answering."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Backend(Generic[P]):
    """An implementation with what it is called: errors, reports, provenance and keys of stored results name it."""

    kind: str
    name: str
    version: str
    """Of the package it came with."""
    made: P
    downloads: bool = False
    """Whether it may fetch weights that are not here."""

    def __str__(self) -> str:
        return f"{self.kind} back end {self.name} {self.version}"

    @property
    def told(self) -> str:
        """Name and version, and what the implementation tells of its model: weights, revision, licence, device."""
        provenance: object = getattr(self.made, "provenance", None)
        facts = provenance if isinstance(provenance, Mapping) else dict[str, str]()
        more = ", ".join(f"{name} {value}" for name, value in facts.items() if value)
        return one_line(f"{self.name} {self.version}{more and f' ({more})'}")

    @property
    def key(self) -> str:
        """For stored results: another version, another source file of the implementation, or another model is another
        key."""
        try:
            source = Path(inspect.getfile(type(self.made))).read_bytes()
        except (OSError, TypeError):  # made in a console
            source = b""
        model = self.told.removeprefix(f"{self.name} {self.version}")
        return f"{self.kind} {self.name} {self.version} {hashlib.sha256(source).hexdigest()}{model}"

    def needs(self) -> tuple[Need, ...]:
        """What it cannot answer without; nothing where the implementation does not tell."""
        ask: Callable[[], Sequence[Need]] = getattr(self.made, "needs", tuple)
        return tuple(ask())

    def require_ready(self) -> None:
        """Raise InputError for the first of its needs that is not met, BackendError where they are unknown.

        How much memory is free changes, and weights may come from the hub where the user allows it."""
        for need in self.asked(lambda made: self.needs()):
            if not need.met and need.what != "memory" and not (need.what == "weights" and self.downloads):
                found = f"{need.what}: {need.found}"
                raise InputError(f"{self.kind} back end {self.name}", found=found, accepted=need.remedy or need.what)

    def telling(self, tell: Callable[[str], None]) -> Self:
        """The same, which tells what it is at, as a place in a queue, where the implementation has ``telling``."""
        ask = getattr(self.made, "telling", None)
        return replace(self, made=ask(tell)) if callable(ask) else self

    def asked(self, question: Callable[[P], T]) -> T:
        """What it answers, unchecked. BackendError for whatever it raises; f3sr's own errors pass."""
        try:
            return question(self.made)
        except F3srError:
            raise
        except Exception as error:  # others' code may raise anything
            raise BackendError(f"{self}: {unforeseen(error, 'it gave no answer')}") from error


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """One offered implementation: its name, its source and its problem. An empty ``problem`` means that it loads.

    ``needs`` are what it cannot answer without: packages, weights, a device, a key."""

    name: str
    source: str
    problem: str = ""
    needs: tuple[Need, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Kind(Generic[P]):
    """Implementations of one Protocol by name: built-in ones and those of installed packages."""

    name: str
    """Third parties' are in the entry point group ``f3sr.NAME``."""
    protocol: type[P]
    built_in: Mapping[str, str] = field(default_factory=dict[str, str])
    """``module:attribute`` by name."""

    @property
    def group(self) -> str:
        return f"f3sr.{self.name}"

    def find(self, spec: str, choice: ModelChoice | None = None) -> Backend[P]:
        """The implementation of ``NAME`` or ``NAME:MODEL``; the choice tells device, precision and downloads.

        Raises InputError where the name has none or several, BackendError where it cannot be imported or
        constructed, or lacks a method of the Protocol."""
        require_kind(f"{self.name} back end", spec, str, accepted="a name, as f3sr doctor lists them")
        all_offers = list(self._offers())
        is_name = any(offer.name == spec for offer in all_offers)
        name, _, model = (spec, "", "") if is_name else spec.partition(":")
        choice = replace(choice or ModelChoice(), model=model)
        offers = [offer for offer in all_offers if offer.name == name]
        if not offers:
            raise self._unknown(name)
        if len(offers) > 1:
            raise InputError(
                f"{self.name} back end",
                found=f"{name} from {' and from '.join(offer.source for offer in offers)}",
                accepted="one of a name: uninstall the other, or ask its authors for another name",
            )
        return self._loaded(offers[0], choice)

    def examined(self) -> Iterator[Found]:
        """Every name, each tried out."""
        offers = list(self._offers())
        for offer in offers:
            try:
                if offer.problem:
                    raise BackendError(offer.problem)
                needs = self.find(offer.name).needs()
            except F3srError as error:
                yield Found(name=offer.name, source=offer.source, problem=str(error))
            except Exception as error:  # others' code may raise anything
                yield Found(name=offer.name, source=offer.source, problem=unforeseen(error, "its needs are unknown"))
            else:
                yield Found(name=offer.name, source=offer.source, needs=needs)

    def names(self) -> list[str]:
        """All names, sorted, whether they can be loaded or not."""
        return sorted({offer.name for offer in self._offers() if offer.name})

    def _offers(self) -> Iterator[_Offer]:
        for name, target in self.built_in.items():
            point = metadata.EntryPoint(name=name, value=target, group=self.group)
            yield _Offer(name=name, source="f3sr itself", version=f3sr.__version__, load=point.load)
        yield from _offered(self.group)

    def _unknown(self, name: str) -> InputError:
        known = ", ".join(self.names()) or "none is installed"
        return InputError(
            f"{self.name} back end",
            found=repr(name),
            accepted=f"{known}; a package with an entry point in the group {self.group} adds one (docs: contributing)",
        )

    def _loaded(self, offer: _Offer, choice: ModelChoice) -> Backend[P]:
        what = f"{self.name} back end {offer.name} from {offer.source}"
        try:
            maker = offer.load()
            takes_model = getattr(maker, "takes_model", False) is True
            if choice.model and not takes_model:
                accepted = f"{offer.name} without a model"
                raise InputError(f"{self.name} back end", found=f"{offer.name}:{choice.model}", accepted=accepted)
            made = maker(choice) if takes_model else maker()
            missing = self._missing(made)
        except F3srError:
            raise
        except (Exception, SystemExit) as error:  # others' code may raise anything
            raise BackendError(f"{what}: {unforeseen(_plain(error), 'it cannot be loaded')}") from error
        if missing:
            raise BackendError(f"{what}: has no {', '.join(missing)}; accepted: all of {self.protocol.__name__}")
        return Backend(
            kind=self.name, name=offer.name, version=offer.version, made=cast(P, made), downloads=choice.allow_downloads
        )

    def _missing(self, made: object) -> list[str]:
        """What the Protocol asks for and this has not: a method is something that can be called."""
        wanted = {name: value for name, value in vars(self.protocol).items() if not name.startswith("_")}
        found = {name: getattr(made, name, None) for name in wanted}
        return [
            f"{name}()" if inspect.isfunction(value) else name
            for name, value in wanted.items()
            if found[name] is None or (inspect.isfunction(value) and not callable(found[name]))
        ]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Offer:
    """An implementation that has not been imported yet."""

    name: str
    source: str
    version: str
    load: Callable[[], Any]
    problem: str = ""


def _offered(group: str) -> Iterator[_Offer]:
    """What installed packages offer; each is read by itself, so that one that is damaged hides no other."""
    seen = set[tuple[str, str, str]]()
    for package in metadata.distributions():
        for offer in _offers_of(package, group):
            if (key := (offer.name, offer.source, offer.problem)) not in seen:  # a path may be listed twice
                seen.add(key)
                yield offer


def _offers_of(package: metadata.Distribution, group: str) -> Iterator[_Offer]:
    if group not in _text(package):  # nearly all: parsing their entry points takes most of the time
        return
    try:
        points = [point for point in package.entry_points if point.group == group]
        name, version = (package.metadata["Name"], package.version) if points else ("", "")
    except Exception as error:  # others' files may hold anything
        problem = f"its entry points cannot be read ({type(error).__name__})"
        yield _Offer(name="", source=_place(package), version="", load=_nothing, problem=problem)
        return
    for point in points:
        yield _Offer(
            name=point.name, source=one_line(f"{name} {version}"), version=one_line(str(version)), load=point.load
        )


def _text(package: metadata.Distribution) -> str:
    try:
        return package.read_text("entry_points.txt") or ""
    except (OSError, ValueError):
        return ""


def _place(package: metadata.Distribution) -> str:
    return Path(str(getattr(package, "_path", "a package"))).name


def _nothing() -> object:
    return None


def _plain(error: BaseException) -> Exception:
    return error if isinstance(error, Exception) else RuntimeError("it ended the process")
