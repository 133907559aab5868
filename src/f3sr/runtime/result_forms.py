"""How results of stages are stored: plain typed values as JSON, scenes and pictures as arrays beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, Protocol, TypeVar

from pydantic import TypeAdapter

from f3sr.report import Outcome
from f3sr.runtime import scene_serialization
from f3sr.runtime.result_store import Arrays
from f3sr.scene import Scene

T = TypeVar("T")
A = TypeVar("A")
R = TypeVar("R", bound=Outcome)


class Form(Protocol[T]):
    """A result as a JSON document with arrays, and back, exactly."""

    def packed(self, result: T, /) -> tuple[Any, Arrays]: ...
    def unpacked(self, document: Any, arrays: Arrays, /) -> T: ...


@dataclass(frozen=True)
class PlainForm(Generic[T]):
    """Of a dataclass of plain values, also nested: its types say what comes back."""

    kind: type[T]

    def packed(self, result: T) -> tuple[Any, Arrays]:
        return _adapter(self.kind).dump_python(result, mode="json"), {}

    def unpacked(self, document: Any, _: Arrays) -> T:
        return _adapter(self.kind).validate_python(document)


@dataclass(frozen=True)
class SceneForm(Generic[R]):
    """Of a scene that a stage made of ``base``, with its outcome."""

    base: Scene
    kind: type[R]

    def packed(self, result: tuple[Scene, R]) -> tuple[Any, Arrays]:
        document, arrays = scene_serialization.pack(result[0])
        return {"scene": document, "outcome": PlainForm(self.kind).packed(result[1])[0]}, arrays

    def unpacked(self, document: Any, arrays: Arrays) -> tuple[Scene, R]:
        scene = scene_serialization.unpack(self.base, document["scene"], arrays)
        return scene, PlainForm(self.kind).unpacked(document["outcome"], arrays)


@dataclass(frozen=True)
class ArraysForm(Generic[A, R]):
    """Of a dataclass of arrays, with an outcome."""

    of: type[A]
    kind: type[R]

    def packed(self, result: tuple[A, R]) -> tuple[Any, Arrays]:
        made, outcome = result
        return PlainForm(self.kind).packed(outcome)[0], dict(vars(made))

    def unpacked(self, document: Any, arrays: Arrays) -> tuple[A, R]:
        return self.of(**arrays), PlainForm(self.kind).unpacked(document, arrays)


@cache
def _adapter(kind: type[T]) -> TypeAdapter[T]:
    return TypeAdapter(kind)
