"""The film of a played goal: film.mp4, a strip of its key frames, a page that plays it beside the rollout in 3-D."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from fractions import Fraction

from f3sr.core.transforms import Array
from f3sr.film.captions import slowed
from f3sr.film.footage import footage
from f3sr.film.moments import Moment, key_moments, moments_of
from f3sr.film.payload import Shown
from f3sr.film.player import player
from f3sr.film.slow_motion import factor, rate_of
from f3sr.film.strip import Title, strip
from f3sr.film.video import Picture, Video, encode
from f3sr.goals.file_names import FILM, FILMS, PLAYER, STRIP
from f3sr.goals.plan import Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.verify import Verdict
from f3sr.runtime.daemon_thread import ahead
from f3sr.scene import Scene

__all__ = ["FILM", "FILMS", "PLAYER", "STRIP", "Moment", "Video", "encode", "key_moments", "make_film"]

Draw = Callable[[Array], Picture]
"""The picture (h, w, 3) uint8 sRGB of a scene whose objects are at T_world_object (N, 4, 4), in the scene's order."""


def make_film(
    scene: Scene,
    plan: Plan,
    rollout: Rollout,
    verdict: Verdict,
    draw: Draw,
    *,
    slow: Fraction | float = 1,
    opening: float = 0.0,
    closing: float = 0.0,
) -> Mapping[str, bytes]:
    """The bytes of film.mp4, film.png and player.html, by name; the same for the same rollout and pictures.

    ``scene`` is a package's. ``draw`` is called for every frame once, in order, with poses (N, 4, 4). ``slow`` is the
    factor of slow motion: the plan is played again with more samples, and every frame shows the speed. ``opening``
    is how long the scene is first shown at rest [s]; after it, what starts elsewhere is lifted there. ``closing`` is
    how long the end stays [s]. Raises InputError if that gives another motion or a frame cannot be filmed,
    OutputError if the encoder fails.
    """
    slow = factor(slow)
    film = footage(scene, plan, rollout, verdict, slow, opening=opening, closing=closing)
    drawn = film.rollout
    moments = moments_of(film.scenarios)
    kept: dict[int, Picture] = {}
    frames = _noted(ahead(map(draw, drawn.T_world_object)), {m.frame for m in moments}, kept)
    video = encode(slowed(frames, slow), rate_of(drawn) / slow)
    pictures = [kept[m.frame] for m in moments]
    shown = Shown(scene=scene, plan=plan, verdict=verdict, footage=film, video=video, moments=moments, slow=slow)
    return {
        FILM: video.data,
        STRIP: strip(moments, pictures, Title(goal=plan.goal, met=verdict.met)),
        PLAYER: player(shown),
    }


def _noted(frames: Iterable[Picture], wanted: Set[int], kept: dict[int, Picture]) -> Iterator[Picture]:
    """The same frames; the wanted ones are also put into ``kept``."""
    for k, frame in enumerate(frames):
        if k in wanted:
            kept[k] = frame
        yield frame
