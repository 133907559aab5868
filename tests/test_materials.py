"""Materials by label: the last word that tells something counts, and the longest way of saying it."""

from __future__ import annotations

import pytest

from f3sr.language.grammar.materials import material_of


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("tomato soup can", "full tin"),
        ("tomato", "soft fruit"),
        ("Tomatoes", "soft fruit"),
        ("tennis ball", "felted rubber"),
        ("ball", "inflated ball"),
        ("ping-pong ball", "celluloid"),
        ("cracker box", "cardboard with contents"),
        ("foam brick", "foam"),
        ("brick", "stone"),
        ("wooden spoon", "wood"),
        ("spoon", "cutlery"),
        ("plastic cup", "plastic"),
        ("wooden chair", "wooden furniture"),
        ("glass", "glass"),
        ("metal", "metal"),
        ("b lego duplo", "plastic"),
        ("mustard bottle", "full plastic bottle"),
        ("canned strawberries", "soft fruit"),
        ("potted meat can", "full tin"),
    ],
)
def test_what_labels_tell(label: str, name: str) -> None:
    material = material_of(label)
    assert material is not None and material.name == name


@pytest.mark.parametrize("label", ["", "03", "thing", "scan", "eggplant"])
def test_what_they_do_not_tell(label: str) -> None:
    assert material_of(label) is None
