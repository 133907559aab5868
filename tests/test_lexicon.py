"""Laws of the vocabulary's files: every word is read as itself, none stands in two places, faults are named."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import get_args

import pytest

from f3sr.errors import InputError
from f3sr.goals.plan import Manner
from f3sr.goals.refusal import Refusal
from f3sr.language.grammar.lexicon import (
    FILES,
    FOLDER,
    Axis,
    Direction,
    Family,
    Lexicon,
    Vague,
    lexicon,
    read,
    regular_forms,
)
from f3sr.language.grammar.materials import Materials, materials
from f3sr.language.grammar.normaliser import canonical, plain, words_of
from f3sr.language.grammar.nouns import compounded, fit, singular
from f3sr.language.grammar.parser import understand
from f3sr.vision.colour_terms import BASIC

NOUNS = {
    *(word for line in lexicon().synonyms for word in line),
    *lexicon().kinds,
    *(word for words in lexicon().kinds.values() for word in words),
    *(word for words in lexicon().shapes.values() for word in words),
    *lexicon().compounds.values(),
    *lexicon().plurals.values(),
    *lexicon().pairs,
    *lexicon().ground,
    *lexicon().anything,
}


def test_every_file_is_read():
    assert {file.stem for file in FOLDER.glob("*.toml")} == {*FILES, "materials"}


def test_nouns_are_singular_and_normalise_to_themselves():
    changed = {w for w in NOUNS if not w == singular(w) == canonical(w) == plain(w) or compounded([w]) != (w,)}
    assert not changed


def test_names_of_materials_are_singular_and_normalise_to_themselves():
    names = [name for m in materials().materials for name in m.labels]
    assert [n for n in names if tuple(map(singular, words_of(" ".join(n)))) != n] == []


def test_two_part_names_and_plurals_are_told_from_words():
    assert all(len(pair.split()) == 2 for pair in lexicon().compounds)
    assert all(singular(plural) == word for plural, word in lexicon().plurals.items())
    assert fit(["pringles"], ["chips", "can"]) == 2 and fit(["crackers"], ["cracker", "box"]) == 1


def test_names_of_one_thing_find_each_other():
    pairs = [(a, b) for line in lexicon().synonyms for a in line for b in line]
    assert [pair for pair in pairs if fit([pair[0]], ["red", pair[1]]) not in (0, 2)] == []


def test_every_word_of_a_closed_set_is_used():
    assert set(lexicon().families.values()) == set(get_args(Family))
    assert set(lexicon().orders.values()) == set(get_args(Axis))
    assert set(lexicon().headings.values()) == set(get_args(Direction))
    assert (set(lexicon().vague), set(lexicon().manner)) == (set(get_args(Vague)), set(get_args(Manner)))
    assert set(lexicon().colours) == set(BASIC)


def test_every_form_of_a_verb_is_a_verb():
    forms = sorted(form for form in lexicon().forms if canonical(form) == form)
    answers = {form: understand(f"{form} the red cup into the bowl") for form in forms}
    refused = {form: found for form, found in answers.items() if isinstance(found, Refusal)}
    no_verb = {"other", "negation", "language"}
    assert [f for f, found in refused.items() if found.reason in no_verb or "has no verb" in found.message] == []


def test_no_other_verb_is_acted_on():
    answers = {word: understand(f"push the red cup left and {word} it") for word in sorted(lexicon().other_verbs)}
    assert [w for w, found in answers.items() if not (isinstance(found, Refusal) and found.reason == "other")] == []


@pytest.mark.parametrize(
    ("verb", "forms"),
    [
        ("drop", "drops dropping dropped"),
        ("tap", "taps tapping tapped"),
        ("chuck", "chucks chucking chucked"),
        ("shove", "shoves shoving shoved"),
        ("scoot", "scoots scooting scooted"),
        ("carry", "carries carrying carryed"),
        ("toss", "tosses tossing tossed"),
        ("draw", "draws drawing drawed"),
    ],
)
def test_regular_forms(verb: str, forms: str):
    assert regular_forms(verb) == [verb, *forms.split()]


def test_relations_and_targets_are_spelt_as_phrases_become():
    words = lexicon().relations | lexicon().targets
    assert [w for w in words if canonical(w.replace("-", " ")) not in (w, w.replace("-", " "))] == []
    assert all(canonical(canonical(f"cup {w} the box")) == canonical(f"cup {w} the box") for w in words)


FAULTS = {
    "a word in two families": ("verbs", 'bounce = "', 'bounce = "topple ', "'topple' stands in tip and bounce"),
    "a verb that is refused": ("refused", 'other_verbs = """', 'other_verbs = """ toss ', "'toss' stands in families"),
    "a word that is no word": ("nouns", 'ground = "', 'ground = "Earth ', "small letters"),
    "an unknown table": ("nouns", 'ground = "', 'earth = "', "earth"),
    "a missing table": ("directions", 'viewer = "', 'watcher = "', "viewer"),
    "an unknown family": ("verbs", 'bounce = "', 'hover = "', "hover"),
    "a broken expression": ("phrases", "['on to', 'onto']", "['on (to', 'onto']", "regular expression"),
    "a colour nobody sees": ("adjectives", 'pink = "', 'infrared = "', "infrared"),
    "a thing of no colour": ("adjectives", 'colour_things = "', 'colour_things = "brick ', "'brick'"),
    "no TOML": ("amounts", "[numbers]", "[numbers", "no TOML"),
}


@pytest.mark.parametrize(("file", "old", "new", "said"), FAULTS.values(), ids=FAULTS)
def test_faults_are_named(tmp_path: Path, file: str, old: str, new: str, said: str):
    folder = Path(shutil.copytree(FOLDER, tmp_path / "vocabulary"))
    text = (folder / f"{file}.toml").read_text()
    assert text.count(old) >= 1
    (folder / f"{file}.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read(Lexicon, *FILES, folder=folder)
    assert said in str(caught.value) and "accepted" in str(caught.value)


def test_a_name_of_two_materials_is_a_fault(tmp_path: Path):
    row = '{ density = 500, friction = 0.5, restitution = 0.2, structure = "solid", name = "it", labels = "cup, mug" }'
    (tmp_path / "materials.toml").write_text(f"materials = [{row}, {row}]\nsubstances = []")
    with pytest.raises(InputError, match=r"materials.toml.*'cup' names two materials"):
        read(Materials, "materials", folder=tmp_path)
