"""Which object of a scene a phrase means, or why none: by label, synonym, colour, size, order, place and support."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

from f3sr.goals.refusal import NotUnderstoodError, Reason, Refusal, listed, quoted, refuse
from f3sr.language.grammar import nouns
from f3sr.language.grammar.lexicon import lexicon
from f3sr.language.grammar.normaliser import canonical, plain, spoken
from f3sr.language.grammar.referring_expressions import Phrase, parsed
from f3sr.language.grammar.request import Request
from f3sr.language.object_queries import Sight
from f3sr.scene import GROUND, Scene

PRONOUNS = {"it", "itself", "back"}
"""They mean the active object."""
OTHER = "other "
"""A target that is called so is not the active object."""
SHOWN = 8
"""Objects that a refusal tells apart."""


@dataclass(frozen=True, kw_only=True)
class Named:
    """The ids of what a request names."""

    active: int
    target: int | None = None
    spared: tuple[int, ...] = ()


def resolve_request(request: Request, scene: Scene, *, before: Named | None = None) -> Named | Refusal:
    """The objects of a request; ``it`` is the active object of the request ``before``. Refused where not one object
    fits, or the active one is fixed or its own target."""
    try:
        return _named(request, Sight(scene), before)
    except NotUnderstoodError as error:
        return error.refusal


def resolve(phrase: str, scene: Scene, *, active: int | None = None) -> int | Refusal:
    """The id of the one object that a phrase means, GROUND for the ground; ``it`` is the ``active`` object, which no
    other words mean where they fit another object too.

    A refusal's candidates are phrases that select one object each.
    """
    try:
        return _resolved(phrase, Sight(scene), active)
    except NotUnderstoodError as error:
        return error.refusal


def names(scene: Scene) -> dict[int, str]:
    """A phrase for every object that selects it and nothing else."""
    sight = Sight(scene)
    return {o.id: _distinct(o.id, sight) for o in scene}


def _named(request: Request, sight: Sight, before: Named | None) -> Named:
    scene, called = sight.scene, quoted(spoken(request.active))
    earlier = None if before is None else before.active
    again = earlier is not None and canonical(plain(request.active)) in PRONOUNS
    active = _resolved(request.active, sight, earlier if again else None)
    if active == GROUND or scene[active].mobility == "fixed":
        free = [o.id for o in scene if o.mobility == "dynamic"]
        refuse("fixed", f"{called} is fixed; accepted: an object that can move", _told_apart(free, sight))
    it = active if earlier is None else earlier
    target = None if request.target is None else _resolved(request.target, sight, active, it=it)
    if target == active:
        others = [o.id for o in scene if o.id != active]
        refuse("same", f"{called} is also its own target; accepted: another target", _told_apart(others, sight))
    spared = tuple(_resolved(phrase, sight, active) for phrase in request.spared)
    if GROUND in spared:
        refuse("grammar", "the ground cannot fall over; accepted: an object that is to stay upright")
    return Named(active=active, target=target, spared=spared)


def _resolved(phrase: str, sight: Sight, active: int | None, *, it: int | None = None) -> int:
    words = canonical(plain(phrase))
    if words in PRONOUNS and active is not None:
        return active if it is None else it
    if words in PRONOUNS - {"back"}:
        refuse("ambiguous", f"{quoted(words)} refers to no object; accepted: an object's name")
    other = active is not None and words.startswith(OTHER)
    words = words.removeprefix(OTHER) if other else words
    ids, plural = _meant(words, sight)
    if plural:
        _refuse_all("plural", f"{quoted(spoken(words))} means more than one object", ids, sight)
    if other or len(ids) > 1:
        ids = [id for id in ids if id != active]
    if not ids:
        everything = [o.id for o in sight.scene if o.id != active]
        _refuse_all("unknown", f"the scene has no other {quoted(spoken(words))}", everything, sight)
    if len(ids) > 1:
        _refuse_all("ambiguous", f"{quoted(spoken(words))} may mean {len(ids)} objects", ids, sight)
    return ids[0]


def _meant(words: str, sight: Sight) -> tuple[list[int], bool]:
    """All objects that canonical words fit, at least one, and whether the words mean several."""
    tokens = nouns.compounded(words.split())
    if len(tokens) > 1 and (labelled := [id for id, label in sight.labels.items() if label == tokens]):
        return labelled, False
    phrase = parsed(words, sight.vocabulary)
    ids = _matching(phrase, sight)
    return ids, phrase.plural or _plural_noun(phrase, sight)


def _matching(phrase: Phrase, sight: Sight) -> list[int]:
    """All objects that a phrase fits, at least one. Where it describes, everything that might be called so is looked
    at, and the best named of what remains is taken: the white bottle may be labelled a cleanser."""
    best, any_ = _called(phrase, sight)
    if not best:
        _refuse_unknown(phrase, sight)
    if best == [GROUND] or not (phrase.colours or phrase.relation or phrase.orders):
        return best
    found = _described(phrase, any_, sight)
    return [id for id in found if id in best] or found


def _described(phrase: Phrase, ids: list[int], sight: Sight) -> list[int]:
    """Those of some objects that a phrase's adjectives fit: colours and relations first, order last."""
    meant = [set(lexicon().colours_of[word]) for word in phrase.colours]
    coloured = [id for id in ids if all(colours.intersection(sight.colours(id)) for colours in meant)]
    if not coloured:
        _refuse_none(phrase, f"none of {len(ids)} is {' and '.join(phrase.colours)}", ids, sight)
    ids = coloured
    if phrase.relation:
        relation, anchor = phrase.relation
        related = sight.related(relation, ids, _matching(anchor, sight))
        if not related:
            _refuse_none(phrase, f"none of {len(ids)} is {spoken(relation)} {anchor.words}", ids, sight)
        ids = related
    return _in_order(phrase, ids, sight)


def _in_order(phrase: Phrase, ids: list[int], sight: Sight) -> list[int]:
    for order in phrase.orders:
        if order.axis is None:
            _refuse_all("ambiguous", f"{quoted(phrase.words)} does not say from which side", ids, sight)
        picked = sight.picked(order.axis, order.rank, ids)
        if not picked:
            _refuse_none(phrase, f"there are only {len(ids)}", ids, sight)
        ids = picked
    return ids


def _called(phrase: Phrase, sight: Sight) -> tuple[list[int], list[int]]:
    """The objects that the phrase's names fit best, and all that they fit but for those that share an adjective."""
    everything = [o.id for o in sight.scene]
    if phrase.id is not None or not phrase.names:
        ids = [id for id in everything if phrase.id in (None, id)]
        return ids, ids
    fits = {id: nouns.fit(phrase.names, label) for id, label in sight.labels.items()}
    known = {id: level for id, level in fits.items() if level is not None}
    if known:
        best = min(known.values())
        return [id for id in known if known[id] == best], [id for id in known if known[id] in (best, 0, 2, 3)]
    name, *more = phrase.names
    ids = [GROUND] if name in lexicon().ground else _shaped(nouns.singular(name), sight)
    return ([], []) if more else (ids, ids)


def _shaped(name: str, sight: Sight) -> list[int]:
    """Objects without a label by their form."""
    return [id for id, description in sight.shapes.items() if nouns.fits_shape(name, description)]


def _plural_noun(phrase: Phrase, sight: Sight) -> bool:
    """``the cups``; what is itself a label's plural, or like ``crackers`` only a part of one, names one thing."""
    head = phrase.names[-1:]
    several = any(nouns.singular(n) != n and n not in sight.vocabulary for n in head)
    return several and any(nouns.fit(phrase.names, label) in (0, 2, 3) for label in sight.labels.values())


# --- refusals -----------------------------------------------------------------------------------------------------


def _refuse_all(reason: Reason, found: str, ids: Sequence[int], sight: Sight) -> NoReturn:
    """Refuses words that fit several objects, and tells these apart."""
    apart = _told_apart(ids, sight)
    refuse(reason, f"{found}; accepted: {_some_of(ids, apart)}", apart)


def _refuse_none(phrase: Phrase, why: str, ids: Sequence[int], sight: Sight) -> NoReturn:
    """Refuses words that fit no object of those that are called so."""
    _refuse_all("unknown", f"the scene has no {quoted(phrase.words)}, {why}", ids, sight)


def _refuse_unknown(phrase: Phrase, sight: Sight) -> NoReturn:
    """Refuses a name that no object has."""
    everything = [o.id for o in sight.scene]
    if "and" in phrase.names:
        _refuse_all("plural", f"{quoted(phrase.words)} means more than one object", everything, sight)
    near = _nearest_names(phrase, sight)
    apart = _told_apart(near or everything, sight)
    hint = f"did you mean {_some_of(near, apart)}?" if near else f"it has {_some_of(everything, apart)}"
    refuse("unknown", f"the scene has no {quoted(phrase.words)}; {hint}", apart)


def _nearest_names(phrase: Phrase, sight: Sight) -> list[int]:
    """Objects of which a word of the label is spelt much like one of the phrase's, the likest first."""
    far = {
        id: min((nouns.distance(a, b) / max(len(a), len(b)) for a in phrase.names for b in label), default=1.0)
        for id, label in sight.labels.items()
    }
    return [id for id in sorted(far, key=lambda id: far[id]) if far[id] <= 0.4][:3]


# --- telling apart ------------------------------------------------------------------------------------------------


def _some_of(ids: Sequence[int], apart: tuple[str, ...]) -> str:
    """Objects told apart, and how many were left out."""
    left = len([id for id in ids if id != GROUND]) - len(apart)
    return listed((*apart, f"{left} more that 'f3sr goals' lists") if left else apart)


def _told_apart(ids: Sequence[int], sight: Sight) -> tuple[str, ...]:
    return tuple(_distinct(id, sight) for id in ids[:SHOWN] if id != GROUND)


def _distinct(id: int, sight: Sight) -> str:
    """The first phrase that selects one object alone."""
    return next((words for words in _phrases(id, sight) if _selects(words, id, sight)), f"object {id}")


def _selects(words: str, id: int, sight: Sight) -> bool:
    """Whether words mean an object and no other."""
    try:
        return _meant(canonical(words), sight) == ([id], False)
    except NotUnderstoodError:
        return False


def _is_plain(label: str) -> bool:
    """Whether a goal may hold a label."""
    try:
        return bool(plain(label))
    except NotUnderstoodError:
        return False


def _phrases(id: int, sight: Sight) -> Iterator[str]:
    """Phrases for an object, the shortest first."""
    label = " ".join(sight.labels[id])
    base = spoken(label) if _is_plain(label) else "object"
    if label:
        yield base
    for colour in sight.colours(id):
        yield f"{colour} {base}"
    for order in ("left", "right", "middle", "front", "back", "upper", "lower", "small", "big", "tall"):
        yield f"{order} {base}"
    for support in sight.scene[id].supports:
        if support.id != GROUND and (below := " ".join(sight.labels.get(support.id, ()))):
            yield f"{base} on {below}"
    for rank in ("second", "third", "fourth", "fifth"):
        yield f"{rank} {base} from left"
