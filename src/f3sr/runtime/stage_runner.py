"""Runs the stages of one reconstruction: skips, resumes from stored results, keeps reports and times."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from typing import Any, TypeVar

from f3sr.errors import InputError
from f3sr.report import Report, report_of
from f3sr.runtime import scene_serialization
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.progress import Progress, Step, timed
from f3sr.runtime.result_store import Arrays, Store, code_version, digest
from f3sr.scene import Scene

T = TypeVar("T")


class Runner:
    """Calls stage after stage. A stage's key hashes the code, the key before it, its name and its configuration, so a
    stored result is taken exactly when everything it depends on is the same. What a limit on time has cut short depends
    on more than that: neither it nor what follows from it is stored."""

    def __init__(
        self, key: str, *, skip: Collection[str], skippable: Sequence[str], store: Store | None, progress: Progress
    ) -> None:
        if unknown := sorted(set(skip) - set(skippable)):
            raise InputError("--skip", found=", ".join(unknown), accepted=", ".join(skippable))
        self.skip, self.store, self.progress = frozenset(skip), store, progress
        self.key = digest(key, code_version())
        self.reports: list[Report] = []
        self.scenes: dict[str, Scene] = {}
        """The scene after every stage that was not skipped."""
        self.seconds: dict[str, float] = {}
        self.resumed: list[str] = []
        """Stages whose results were taken from the store."""

    def stage(
        self, name: str, work: Callable[..., tuple[Scene, Report]], scene: Scene, config: Any, **more: Any
    ) -> Scene:
        """The scene after the stage; ``scene`` itself when the stage is skipped."""

        def restored(document: Any, arrays: Arrays) -> tuple[Scene, Report]:
            return scene_serialization.unpack(scene, document["scene"], arrays), report_of(document["report"])

        def worked() -> tuple[Scene, Report]:
            changed, report = work(scene, config, **more)
            if report.cut_short:
                self.store = None
            return changed, report

        def stored(result: tuple[Scene, Report]) -> tuple[Any, Arrays]:
            document, arrays = scene_serialization.pack(result[0])
            return {"scene": document, "report": asdict(result[1])}, arrays

        result = self.value(name, worked, restored, stored, config)
        return scene if result is None else self._keep(name, *result)

    def _keep(self, name: str, scene: Scene, report: Report) -> Scene:
        self.scenes[name] = scene
        self.reports.append(report)
        return scene

    def value(
        self,
        name: str,
        work: Callable[[], T],
        restored: Callable[[Any, Arrays], T],
        stored: Callable[[T], tuple[Any, Arrays]],
        config: Any = None,
    ) -> T | None:
        """A result from the store, else from ``work``; None when the stage is skipped."""
        self.key = digest(self.key, name, name in self.skip, asdict(config) if config is not None else None)
        return self._ready(self.key, name, work, restored, stored, later=True)()

    def beside(
        self,
        name: str,
        work: Callable[[], T],
        restored: Callable[[Any, Arrays], T],
        stored: Callable[[T], tuple[Any, Arrays]],
        config: Any = None,
        *,
        later: bool = False,
    ) -> Callable[[], T | None]:
        """Begin what no later stage needs in a thread of its own; the call that is returned waits for it, or does it
        where it is to come ``later``. It is stored by what came before it, whatever comes after."""
        key = digest(self.key, name, asdict(config) if config is not None else None)
        return self._ready(key, name, work, restored, stored, later=later)

    def _ready(
        self,
        key: str,
        name: str,
        work: Callable[[], T],
        restored: Callable[[Any, Arrays], T],
        stored: Callable[[T], tuple[Any, Arrays]],
        *,
        later: bool,
    ) -> Callable[[], T | None]:
        """What gives the result, from the store or from ``work``, which begins now unless it is to come ``later``."""
        found = self.store.load(key) if self.store and name not in self.skip else None
        needed = found is None and name not in self.skip
        going_on = begun(work) if needed and not later else None

        def ended() -> T | None:
            if not needed:
                return self._known(name, found, restored)
            with timed(name, self._told):
                result = work() if going_on is None else going_on.result()
                if self.store:  # first of all: what is said to be done stays done
                    self.store.save(key, *stored(result))
            return result

        return ended

    def _known(self, name: str, found: tuple[Any, Arrays] | None, restored: Callable[[Any, Arrays], T]) -> T | None:
        """A stored result; None of what was skipped."""
        if found is None:
            self.progress(Step(name=name, state="skipped"))
            return None
        self.resumed.append(name)
        self.progress(Step(name=name, state="resumed"))
        return restored(*found)

    def _told(self, step: Step) -> None:
        if step.state == "done":
            self.seconds[step.name] = step.seconds
        self.progress(step)
