"""Checks of how two bodies meet and part: touching, landing, lying on, in and off, passing over, flying.

Contacts are judged by distances of convex parts, at samples and on the paths between them; those that the rollout
recorded are only a second witness.
"""

from __future__ import annotations

import numpy as np
from found import Before, Check, Found, before_sample, first
from paths import LOOSE, STEPS, TOUCH, mixed, reach, recorded, touch
from scipy.spatial import ConvexHull, QhullError
from seen import GROUND, Film, placed, unit


def touches(film: Film, c: Check, before: Before) -> Found:
    """The parts of ``a`` and ``b`` come to touch; what touches at the start must part first."""
    a, b = c["a"], c["b"]
    (time, gap), rows = touch(film, a, b), recorded(film, a, b)
    if time is None and len(rows) and np.isfinite(gap):
        k = before_sample(film, rows[0])
        if film.gap(a, b, k, far=1.0) <= reach(film, a, b, k) + LOOSE:
            words = f"seen {1000 * gap:.1f} mm apart, recorded and within reach"
            return Found(check="touches", met=True, time=float(film.time[k + 1]), measured=words)
    words = f"nearest {1000 * gap:.1f} mm of {1000 * TOUCH:.1f}, {'' if len(rows) else 'not '}recorded"
    return Found(check="touches", met=time is not None, time=time, measured=words)


def lands_on(film: Film, c: Check, before: Before) -> Found:
    """It comes down on ``b``: touches it falling, its centre of mass over b's outline and higher than b's."""
    hit = touches(film, c, before)
    if hit.time is None:
        return Found(check="lands_on", met=False, measured=hit.measured)
    k = before_sample(film, hit.time)
    down = film.centre(c["a"])[k + 1, 2] - film.centre(c["a"])[max(k - 1, 0), 2]
    over = is_over(film, c["a"], c["b"], k + 1)
    higher = film.centre(c["a"])[k, 2] > film.centre(c["b"])[k, 2]
    words = f"{'falling' if down < 0 else 'not falling'}, {'over' if over else 'not over'} it, {hit.measured}"
    return Found(check="lands_on", met=bool(down < 0 and over and higher), time=hit.time, measured=words)


def ends_on(film: Film, c: Check, before: Before) -> Found:
    """At the end it lies on ``b``: touches it, over its outline, higher, and off the ground."""
    a, b, k = c["a"], c["b"], len(film.time) - 1
    gap, over, ground = film.gap(a, b, k), is_over(film, a, b, k), film.gap(a, GROUND, k)
    higher = film.centre(a)[k, 2] > film.centre(b)[k, 2]
    words = f"{1000 * gap:.1f} mm from it, {'over' if over else 'not over'} it, {1000 * ground:.0f} mm above the ground"
    met = gap <= TOUCH and over and higher and ground > TOUCH
    return Found(check="ends_on", met=bool(met), time=float(film.time[k]), measured=words)


def ends_in(film: Film, c: Check, before: Before) -> Found:
    """At the end its centre of mass is over b's outline and its lowest point under b's rim, and off the ground; beside
    that it tells how deep its centre is in b's hull."""
    a, b, k = c["a"], c["b"], len(film.time) - 1
    target = film.bodies[b]
    centre = film.centre(a)[k]
    local = (centre - film.T[b][k][:3, 3]) @ film.T[b][k][:3, :3]
    deep = -float((target.hull @ [*local, 1]).max())
    under = float(film.points(b, k)[:, 2].max() - film.points(a, k)[:, 2].min())
    over, ground = is_over(film, a, b, k), film.gap(a, GROUND, k)
    met = ground > TOUCH and over and under >= 0.005
    words = f"middle {1000 * deep:.0f} mm inside its hull, lowest point {1000 * under:.0f} mm under its rim"
    return Found(check="ends_in", met=bool(met), time=float(film.time[k]), measured=words)


def ends_off(film: Film, c: Check, before: Before) -> Found:
    """At the end it no longer lies on ``b``: its centre of mass is beyond b's outline, or it does not touch b."""
    a, b, k = c["a"], c["b"], len(film.time) - 1
    gap, over = film.gap(a, b, k), is_over(film, a, b, k)
    left = np.array([is_over(film, a, b, i) for i in range(len(film.time))])
    words = f"{1000 * gap:.0f} mm from it, {'over' if over else 'beyond'} its outline"
    time = first(film, ~left) if not over else float(film.time[k])
    return Found(check="ends_off", met=bool(not over or gap > LOOSE), time=time, measured=words)


def passes_over(film: Film, c: Check, before: Before) -> Found:
    """Before any touch its centre of mass crosses b's outline, its lowest point above b's highest, and comes out of it
    beyond b's middle."""
    a, b = c["a"], c["b"]
    touched, _ = touch(film, a, b)
    middle = film.centre(b)[0]
    way = unit((middle - film.centre(a)[0]) * [1, 1, 0])
    best, time, beyond = -np.inf, None, -np.inf
    for k in range(len(film.time) if touched is None else before_sample(film, touched) + 1):
        points = film.points(b, k)
        if not inside_outline(film.centre(a)[k], points):
            beyond = max(beyond, float((film.centre(a)[k] - middle) @ way))
        for s in np.arange(STEPS if k + 1 < len(film.time) else 1) / STEPS:
            T = mixed(film, a, k, s) if s else film.T[a][k]
            clear = float(placed(T, film.bodies[a].points)[:, 2].min() - points[:, 2].max())
            if clear > best and inside_outline(placed(T, film.bodies[a].com), points):
                best, time = clear, float(film.time[k])
    words = "never over it" if time is None else f"{1000 * best:.0f} mm above it, {1000 * beyond:.0f} mm beyond"
    return Found(check="passes_over", met=best > 0 and beyond > 0, time=time, measured=words)


def flies(film: Film, c: Check, before: Before) -> Found:
    """At some sample after it is set off, and before it ``touches`` where that was checked, nothing is within 3 mm."""
    hit = before.get("touches")
    end = len(film.time) if hit is None or hit.time is None else before_sample(film, hit.time) + 1
    others = [GROUND, *(id for id in film.bodies if id != c["id"])]
    alone = [k for k in range(1, end) if all(film.gap(c["id"], b, k) > LOOSE for b in others)]
    time = float(film.time[alone[0]]) if alone else None
    return Found(check="flies", met=bool(alone), time=time, measured=f"{len(alone)} samples with nothing near")


def is_over(film: Film, a: int, b: int, k: int) -> bool:
    """Whether a's centre of mass is over b's outline."""
    return inside_outline(film.centre(a)[k], film.points(b, k))


def inside_outline(point: np.ndarray, points: np.ndarray) -> bool:
    try:
        return bool((ConvexHull(points[:, :2]).equations @ [*point[:2], 1]).max() <= 0)
    except QhullError:
        return False
