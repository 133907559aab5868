"""Which mesh belongs to which mask, by the names that both have. Nothing is guessed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from f3sr.errors import InputError

SHOWN = 6
"""Most names in a message."""


def matched(where: Path, labels: Mapping[int, str], names: Sequence[str], *, in_order: bool = False) -> dict[int, str]:
    """A name per id: the one with the id's number, the one with its label, or the only one.

    ``labels`` are those of the masks by id. With ``in_order``, the n-th name by its numbers belongs to the n-th id.
    Raises InputError where the counts differ, and where neither numbers nor labels tell all."""
    if len(names) != len(labels):
        found = f"{len(names)} meshes ({_listed(names)}) for {len(labels)} masks"
        raise InputError(where, found=found, accepted="one mesh per mask, and one mask per mesh")
    if in_order:
        return dict(zip(sorted(labels), sorted(names, key=_natural), strict=True))
    if len(names) == 1:
        return {next(iter(labels)): names[0]}
    for found in (_by_number(labels, names), _by_label(labels, names)):
        if found is not None:
            return found
    masks = [f"{id} {label}".strip() for id, label in sorted(labels.items())]
    accepted = f"names with the number or the label of a mask ({_listed(masks)}), or --in-order"
    raise InputError(where, found=f"meshes {_listed(names)}", accepted=accepted)


def _by_number(labels: Mapping[int, str], names: Sequence[str]) -> dict[int, str] | None:
    """By the first number in every name, where these are the ids, or else by the last."""
    for which in (0, -1):
        digits = [re.findall(r"[0-9]{1,8}", name) for name in names]
        if all(digits):
            found = {int(d[which]): name for d, name in zip(digits, names, strict=True)}
            if found.keys() == labels.keys() and len(found) == len(names):
                return found
    return None


def _by_label(labels: Mapping[int, str], names: Sequence[str]) -> dict[int, str] | None:
    by_name = {_plain(name): name for name in names}
    wanted = {id: _plain(label) for id, label in labels.items()}
    if len(by_name) != len(names) or set(wanted.values()) != by_name.keys() or len(set(wanted.values())) < len(wanted):
        return None
    return {id: by_name[label] for id, label in wanted.items()}


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", " ", name).strip().casefold()


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Numbers in a name count by value: 10 is after 9."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
