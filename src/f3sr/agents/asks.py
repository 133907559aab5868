"""What agents need of a model: one typed question after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from pydantic import BaseModel

M = TypeVar("M", bound=BaseModel)


class Asks(Protocol):
    """A model that answers in records; ``f3sr.models.model_client.ModelClient`` is one."""

    def ask(
        self,
        role: str,
        instructions: str,
        parts: Sequence[str | bytes],
        answer: type[M],
        check: Callable[[M], None] | None = None,
    ) -> M:
        """The answer of a role to texts and PNG pictures. ``check`` raises ValueError with what is wrong with it; that
        goes back once. Raises ModelError without an answer that suits."""
        ...
