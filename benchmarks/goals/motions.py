"""Checks of how one body moves: how far and where to, up and down, over, round and back.

Every check takes the film, its own entry of the checklist and what the checks before it found.
"""

from __future__ import annotations

import numpy as np
from found import Before, Check, Found, directions, first, needed, since
from scipy.spatial.transform import Rotation
from seen import Film, angle

TURNED_OVER = 60.0
"""[deg] of what was up, from where what stood lies; other angles are the goal's own."""
STANDS = 30.0
"""[deg] A body that never leant more than this stayed upright."""
WITHIN = 30.0
"""[deg] A person takes a path this far off for the direction that was asked for."""
FALLS_ALONG = 45.0
"""[deg] The same of what falls over: its corners lead it."""


def moves(film: Film, c: Check, before: Before) -> Found:
    """Its centre of mass is moved along ``direction`` or ``towards`` an object, or anywhere, by ``at_least`` and
    ``at_most``, within ``angle``; at the end, or ``when = "ever"``; counted from the touch with ``after``. Where
    there is a most, the event is the end."""
    k0 = since(c, before, film)
    if k0 is None:
        return Found(check="moves", met=False, measured=f"no {c['after']} that it could come after")
    d = film.centre(c["id"])[k0:] - film.centre(c["id"])[k0]
    ways = directions(film, c, c["id"])
    flat = d * [1, 1, 0]
    along = np.max([flat @ u for u in ways], axis=0) if ways else np.linalg.norm(d, axis=1)
    k = int(along.argmax()) if c.get("when") == "ever" else len(along) - 1
    off = min((angle(flat[k], u) for u in ways), default=0.0)
    fits = c["at_least"] <= along[k] <= c.get("at_most", np.inf) and off <= c.get("angle", WITHIN)
    words = f"{1000 * along[k]:.0f} mm of {needed(c)}" + (f", {off:.0f} deg off" if ways else "")
    time = float(film.time[-1]) if "at_most" in c else first(film, along >= c["at_least"], k0)
    return Found(check="moves", met=bool(fits), time=time, measured=words)


def stays(film: Film, c: Check, before: Before) -> Found:
    """Its centre of mass is never farther than ``at_most`` from where it was."""
    d = film.moved(c["id"])[:, 0]
    words = f"{1000 * d.max():.1f} mm of at most {1000 * c['at_most']:.0f}"
    return Found(check="stays", met=bool(d.max() <= c["at_most"]), measured=words)


def falls(film: Film, c: Check, before: Before) -> Found:
    """Its centre of mass ends lower than it began by ``at_least``."""
    down = film.centre(c["id"])[0, 2] - film.centre(c["id"])[:, 2]
    words = f"{1000 * down[-1]:.0f} mm down of {needed(c)}"
    return Found(
        check="falls", met=bool(down[-1] >= c["at_least"]), time=first(film, down >= c["at_least"]), measured=words
    )


def rises(film: Film, c: Check, before: Before) -> Found:
    """Its centre of mass rises by ``at_least`` at some time."""
    up = film.centre(c["id"])[:, 2] - film.centre(c["id"])[0, 2]
    return Found(
        check="rises",
        met=bool(up.max() >= c["at_least"]),
        time=first(film, up >= c["at_least"]),
        measured=f"{1000 * up.max():.0f} mm up of {needed(c)}",
    )


def returns(film: Film, c: Check, before: Before) -> Found:
    """After its highest point it comes down again to where it was, ``within`` so far along the table."""
    centre = film.centre(c["id"])
    top, level = int(centre[:, 2].argmax()), centre[0, 2] + 0.02
    down = np.flatnonzero(centre[top:, 2] <= level)
    if not top or not len(down):
        return Found(check="returns", met=False, measured="it never goes up and comes down again")
    k = top + int(down[0])
    off = float(np.linalg.norm((centre[k] - centre[0])[:2]))
    words = f"{1000 * off:.0f} mm off of at most {1000 * c['within']:.0f}"
    return Found(check="returns", met=off <= c["within"], time=float(film.time[k]), measured=words)


def rests(film: Film, c: Check, before: Before) -> Found:
    """In the last fifth of a second it moves by at most 5 mm and turns by at most 5 deg."""
    k = int(np.searchsorted(film.time, film.time[-1] - 0.2))
    moved, turned = film.moved(c["id"], film.T[c["id"]][-1])[k:].max(axis=0)
    met = bool(moved <= 5e-3 and turned <= 5)
    return Found(check="rests", met=met, measured=f"{1000 * moved:.1f} mm, {turned:.1f} deg in the last fifth")


def topples(film: Film, c: Check, before: Before) -> Found:
    """What was up in it leans by at least ``degrees`` at the end, over to a ``direction`` or ``towards`` an object; it
    still stood at what it comes ``after``."""
    k0, degrees = since(c, before, film), c.get("degrees", TURNED_OVER)
    if k0 is None:
        return Found(check="topples", met=False, measured=f"no {c['after']} that it could come after")
    up = film.uprights(c["id"])
    lean = np.degrees(np.arccos(np.clip(up[:, 2], -1, 1)))
    ways, over = directions(film, c, c["id"]), np.flatnonzero(lean >= degrees)
    off = min((angle(up[over[0]] * [1, 1, 0], u) for u in ways), default=0.0) if len(over) else 0.0
    met = lean[-1] >= degrees and off <= c.get("angle", FALLS_ALONG) and lean[k0] < STANDS
    words = f"{lean[-1]:.0f} deg of {degrees:.0f} at the end" + (f", {off:.0f} deg off" if ways else "")
    return Found(check="topples", met=bool(met), time=first(film, lean >= degrees), measured=words)


def upright(film: Film, c: Check, before: Before) -> Found:
    """What was up in it never leans by more than ``degrees``."""
    lean = float(np.degrees(np.arccos(np.clip(film.uprights(c["id"])[:, 2], -1, 1))).max())
    most = c.get("degrees", STANDS)
    return Found(check="upright", met=lean <= most, measured=f"{lean:.0f} deg of at most {most:.0f}")


def rolls(film: Film, c: Check, before: Before) -> Found:
    """It turns forwards as it goes, by ``degrees`` in all, and never rises by more than its own radius.

    ``lying``: while it leans by 45 degrees and more it turns about what was up in it."""
    centre, R = film.centre(c["id"]), Rotation.from_matrix(film.T[c["id"]][:, :3, :3])
    steps, turns = np.diff(centre, axis=0), (R[1:] * R[:-1].inv()).as_rotvec()
    if c.get("lying"):
        up = film.uprights(c["id"])[1:]
        about = np.degrees(np.abs(np.cumsum(np.where(up[:, 2] < np.sqrt(0.5), (turns * up).sum(axis=1), 0))))
        words = f"{about.max():.0f} deg lying of {c['degrees']}"
        return Found(check="rolls", met=bool(about.max() >= c["degrees"]), measured=words)
    ahead = np.cross([0, 0, 1.0], steps)
    length = np.linalg.norm(ahead, axis=1)
    forwards = np.where(length > 1e-6, (turns * ahead).sum(axis=1) / np.maximum(length, 1e-6), 0)
    total = np.degrees(np.concatenate([[0], np.cumsum(forwards)]))
    rise = float((centre[:, 2] - centre[0, 2]).max())
    met = total.max() >= c["degrees"] and rise <= film.bodies[c["id"]].radius
    words = f"{total.max():.0f} deg forwards of {c['degrees']}, {1000 * rise:.0f} mm up"
    return Found(check="rolls", met=bool(met), time=first(film, total >= c["degrees"]), measured=words)


def bounces(film: Film, c: Check, before: Before) -> Found:
    """It falls by at least 10 mm and rises again by at least 3 mm, ``before`` it touches where that is said."""
    z, end = film.centre(c["id"])[:, 2], len(film.time) - 1
    if "before" in c:
        found = before.get(c["before"])
        if found is None or found.time is None:
            return Found(check="bounces", met=False, measured=f"no {c['before']} that it could come before")
        end = int(np.searchsorted(film.time, found.time - 1e-9))
    for k in range(1, end):
        high = max(z[: k + 1])
        after = z[k : end + 1]
        rise = float(after[: 1 + int(np.argmax(np.append(np.diff(after) < 0, True)))].max() - z[k])
        if high - z[k] >= 0.01 and rise >= 0.003:
            words = f"down {1000 * (high - z[k]):.0f} mm, up again {1000 * rise:.0f} mm"
            return Found(check="bounces", met=True, time=float(film.time[k]), measured=words)
    return Found(check="bounces", met=False, measured="no fall of 10 mm with a rise of 3 mm after it")
