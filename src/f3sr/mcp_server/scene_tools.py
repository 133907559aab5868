"""What agents can do with scenes, as plain functions of texts: each answers plain values or raises F3srError."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from f3sr.errors import InputError
from f3sr.mcp_server.allowed_root import AllowedRoot
from f3sr.scene_package.package_folder import ROLLOUTS

if TYPE_CHECKING:
    from f3sr.goals.language_protocol import Language
    from f3sr.play.rollout_folder import StoredRollout
    from f3sr.scene_package.package import Package


@dataclass(frozen=True)
class SceneTools:
    """The tools of one root folder. A rollout is its number in its package's folder ``rollouts``."""

    root: AllowedRoot
    language: Callable[[], Language] | None = None
    """Makes the language that reads goals; without it: rules."""

    def reconstruct(self, folder: str, out: str) -> dict[str, Any]:
        """Turn a prompted-image folder (photo, masks, meshes, geometry) into a scene package.

        Args:
            folder: The input folder, relative to the root.
            out: Where the package goes, relative to the root. An older package there is replaced.
        """
        from f3sr.delivery import deliver
        from f3sr.photo_inputs import read_inputs
        from f3sr.pipeline import reconstruct
        from f3sr.runtime.atomic_folder import recover
        from f3sr.scene_package.package import prepare_output

        source, target = self.root.inside(folder), self.root.inside(out)
        recover(target)
        given = read_inputs(source)
        prepare_output(target, inputs=source, overwrite=False)
        result = reconstruct(given)
        written = deliver(result, target)
        row = result.evaluation.result.as_dict() if result.evaluation else {}
        decisions = [d.reason for report in result.reports for d in report.decisions]
        return {"package": self.root.shown(written), "measures": row, "decisions": decisions[:50]}

    def list_objects(self, package: str) -> dict[str, Any]:
        """List the objects of a scene package, with words that select each and verbs that make sense for it.

        Args:
            package: The package's folder, relative to the root.
        """
        from f3sr.language.capabilities import menu

        return {"objects": [asdict(entry) for entry in menu(self._package(package).scene)]}

    def simulate(self, package: str, goal: str, film: bool = False) -> dict[str, Any]:
        """Play a goal in words, as "push the mug off the book, then knock over the can". Tells what was understood, the
        verdict and its side effects, and the number of the rollout.

        Args:
            package: The package's folder, relative to the root.
            goal: What is to happen, in English.
            film: Film it too.
        """
        from f3sr.goals.refusal import Refusal
        from f3sr.play.goal_loop import simulate_goal
        from f3sr.play.rollout_folder import require_next, write_next
        from f3sr.play.telling import telling

        content, start = self._package(package), time.perf_counter()
        require_next(content.folder)
        played = simulate_goal(content, goal, language=self.language() if self.language else None)
        if isinstance(played, Refusal):
            return telling(goal, played, None, time.perf_counter() - start, replayed=False)
        place = write_next(played, content.folder)
        told = telling(goal, played, place, time.perf_counter() - start, replayed=False)
        told |= {"folder": self.root.shown(place), "rollout": int(place.name)}
        return told | (self.film(package, int(place.name)) if film else {})

    def verdict(self, package: str, rollout: int) -> dict[str, Any]:
        """Judge a rollout again: every condition with its margin, broken rules and side effects.

        Args:
            package: The package's folder, relative to the root.
            rollout: Its number.
        """
        from f3sr.goals.verify import as_document, verify

        stored = self._stored(package, rollout)
        verdict = verify(stored.package.scene, stored.plan, stored.rollout)
        return {"goal": stored.plan.goal, **as_document(verdict).model_dump(mode="json")}

    def film(self, package: str, rollout: int) -> dict[str, Any]:
        """Film a rollout from the photo's camera: film.mp4, its key frames film.png, and player.html for a browser.

        Args:
            package: The package's folder, relative to the root.
            rollout: Its number.
        """
        from f3sr.film.studio import film_played
        from f3sr.goals.verify import verify
        from f3sr.play.goal_loop import Played
        from f3sr.play.rollout_folder import require_film_place, write_film

        stored = self._stored(package, rollout)
        place = require_film_place(self._rollout(package, rollout))
        verdict = verify(stored.package.scene, stored.plan, stored.rollout)
        made = film_played(stored.package, Played(plan=stored.plan, rollout=stored.rollout, verdict=verdict))
        write_film(made.files, place)
        files = {name: self.root.shown(place / name) for name in made.files}
        return {"files": files, "frames": made.frames, "size": list(made.size), "film_decisions": list(made.decisions)}

    def key_frames(self, package: str, rollout: int) -> bytes:
        """The key frames of a filmed rollout, as a PNG. Raises InputError where it was not filmed."""
        from f3sr.files import limited_file
        from f3sr.goals.file_names import STRIP

        file = self._rollout(package, rollout) / STRIP
        return limited_file.read(file, most=MAX_STRIP_BYTES, accepted="a rollout that the tool film has filmed")

    def _package(self, package: str) -> Package:
        from f3sr.scene_package.package import read_package

        return read_package(self.root.inside(package))

    def _rollout(self, package: str, rollout: int) -> Path:
        if not re.fullmatch(r"[1-9][0-9]{0,5}", str(rollout)):
            raise InputError("rollout", found=str(rollout)[:20], accepted="the number of a rollout, from 1 on")
        return self.root.inside(f"{package}/{ROLLOUTS}/{rollout}")

    def _stored(self, package: str, rollout: int) -> StoredRollout:
        from f3sr.play.rollout_folder import read_played

        return read_played(self._rollout(package, rollout), self.root.inside(package))


MAX_STRIP_BYTES = 50_000_000
"""Largest film.png that is read: ours have one or two MB."""
