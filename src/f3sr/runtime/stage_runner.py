"""Runs the stages of one reconstruction: skips, resumes from stored results, keeps outcomes and times."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from typing import Any, Concatenate, ParamSpec, TypeVar

from f3sr.errors import require_known
from f3sr.report import Outcome
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.progress import Progress, Step, timed
from f3sr.runtime.result_forms import Form, SceneForm
from f3sr.runtime.result_store import Arrays, Store, code_version, digest
from f3sr.scene import Scene

T = TypeVar("T")
C = TypeVar("C")
R = TypeVar("R", bound=Outcome)
P = ParamSpec("P")


class Runner:
    """Calls stage after stage and stores results.

    A stage's key hashes the code, the key before it, its name and its configuration. So a stored result is used exactly
    when everything that it depends on is equal. A result that a time limit cut short depends on more: neither it nor
    any later one is stored."""

    def __init__(
        self,
        key: str,
        *,
        skip: Collection[str],
        skippable: Sequence[str],
        store: Store | None,
        progress: Progress,
        seen: Callable[[str, Scene], object] = lambda stage, scene: None,
    ) -> None:
        """``seen`` is called with the scene after every stage that was not skipped, as soon as it is there."""
        require_known("--skip", skip, skippable)
        self.skip, self.store, self.progress, self.seen = frozenset(skip), store, progress, seen
        self.key = digest(key, code_version())
        self.outcomes: list[Outcome] = []
        """Of every stage that was not skipped."""
        self.scenes: dict[str, Scene] = {}
        """The scene after every stage that was not skipped."""
        self.seconds: dict[str, float] = {}
        """Wall time [s] of every stage that was worked on here."""
        self.resumed: list[str] = []
        """Stages whose results were taken from the store."""

    def stage(
        self,
        kind: type[R],
        work: Callable[Concatenate[Scene, C, P], tuple[Scene, R]],
        scene: Scene,
        config: C,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> tuple[Scene, R]:
        """The scene after the stage and its outcome; ``scene`` itself and ``kind()`` when the stage is skipped.

        The key hashes ``config``; whatever else the stage reads must come from the inputs or from stages before it."""

        def worked() -> tuple[Scene, R]:
            changed, outcome = work(scene, config, *args, **kwargs)
            if outcome.cut_short:
                self.store = None
            return changed, outcome

        result = self.value(kind.stage, worked, SceneForm(scene, kind), config)
        if result is None:
            return scene, kind()
        self.scenes[kind.stage] = result[0]
        self.outcomes.append(result[1])
        self.seen(kind.stage, result[0])
        return result

    def value(self, name: str, work: Callable[[], T], form: Form[T], config: Any) -> T | None:
        """A result from the store, else from ``work``; None when the stage is skipped."""
        self.key = digest(self.key, name, name in self.skip, asdict(config))
        return self._ready(self.key, name, work, form, later=True)()

    def beside(
        self, name: str, work: Callable[[], T], form: Form[T], config: Any, *, also: str = "", later: bool = False
    ) -> Callable[[], T | None]:
        """Start work that no later stage needs in a separate thread; the returned call waits for its result.

        With ``later`` the returned call does the work itself. Its key depends on the stages before it, and on ``also``.
        """
        return self._ready(digest(self.key, name, asdict(config), also), name, work, form, later=later)

    def _ready(
        self, key: str, name: str, work: Callable[[], T], form: Form[T], *, later: bool
    ) -> Callable[[], T | None]:
        """What gives the result, from the store or from ``work``, which begins now unless it is to come ``later``."""
        found = self.store.load(key) if self.store and name not in self.skip else None
        needed = found is None and name not in self.skip
        going_on = begun(work) if needed and not later else None

        def ended() -> T | None:
            if not needed:
                return self._known(name, found, form)
            with timed(name, self._told):
                result = work() if going_on is None else going_on.result()
                if self.store:  # first of all: what is said to be done stays done
                    self.store.save(key, *form.packed(result))
            return result

        return ended

    def _known(self, name: str, found: tuple[Any, Arrays] | None, form: Form[T]) -> T | None:
        """A stored result; None of what was skipped."""
        if found is None:
            self.progress(Step(name=name, state="skipped"))
            return None
        self.resumed.append(name)
        self.progress(Step(name=name, state="resumed"))
        return form.unpacked(*found)

    def _told(self, step: Step) -> None:
        if step.state == "done":
            self.seconds[step.name] = step.seconds
        self.progress(step)
