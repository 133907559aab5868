"""Materials by label: the last word that tells something counts, and the longest way of saying it."""

from __future__ import annotations

import pytest

from f3sr.language.grammar.materials import COMPACT, LIGHTEST, material_of, unknown_density
from f3sr.scene import SceneObject


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


def test_what_is_large_and_unknown_is_mostly_air() -> None:
    assert unknown_density(COMPACT / 10) == unknown_density(COMPACT) == SceneObject.density
    microwave, refrigerator, wardrobe = map(unknown_density, (0.05, 0.9, 1.8))
    assert 180 < microwave < 320 and 60 < refrigerator < 120 and 40 < wardrobe < 90
    assert unknown_density(3e7) == LIGHTEST, "what is far away may be as large as a mountain"
    for volume in (0.01, 0.3, 2.0):
        assert unknown_density(8 * volume) == pytest.approx(unknown_density(volume) / 2)
    assert unknown_density(0.0) == SceneObject.density
