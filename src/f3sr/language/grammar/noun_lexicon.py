"""What things are called: everyday synonyms, kinds of things, and how well a name fits an object's label."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from f3sr.language.grammar.normaliser import each

SYNONYMS = """
cup mug beaker teacup
can tin
box carton package packet pack case parcel
ball sphere orb globe
bowl basin dish
plate dish saucer platter
bottle flask
jug pitcher
pan frypan skillet fryingpan
pot saucepan
cube block
lego duplo brick block
brick block
padlock lock
wrench spanner
screwdriver driver
airplane aeroplane plane aircraft
bin basket trashcan wastebasket dustbin
microwave oven
couch sofa settee
tv television
monitor screen display
phone telephone cellphone smartphone mobile
laptop computer notebook
glass tumbler goblet
shoe sneaker trainer
bag sack pouch
lamp light
book notebook novel
sponge foam
cooker stove
faucet tap
rug carpet
container tub
detergent cleanser cleaner
remote controller
tube stick
spatula turner
stapler
vase urn
chair seat
stool seat
cupboard cabinet
backpack rucksack
rubiks rubik puzzle
cracker cheezit
gelatin jello
soup campbell
meat spam
mustard french
ketchup heinz
spray windex
tissue kleenex
marker sharpie pen
soda cola coke pepsi
chips pringles
bleach clorox
candle
doll figure figurine
teddy teddybear bear
"""
"""A line holds names of one thing, those of brands too; a name may stand in several."""
KINDS = {
    "fruit": "apple lemon orange strawberry banana pear peach plum lime kiwi mango melon grape",
    "food": "apple lemon orange strawberry banana pear peach plum cheese macaroni bread cake ketchup mustard soup meat",
    "bottle": "cleanser ketchup mustard shampoo windex detergent vinegar sauce",
    "box": "macaroni cereal cracker gelatin tissue pizza",
    "can": "soup spam tuna soda cola beer",
    "silverware": "spoon fork knife",
    "tool": "hammer wrench spanner screwdriver pliers saw drill scissors spatula clamp",
    "vessel": "bowl cup mug pan pot glass vase jug bottle",
    "container": "bowl cup mug pan pot glass vase jug bottle box can bin basket bag tub",
    "toy": "airplane lego duplo cube doll teddy car train",
    "cutlery": "spoon fork knife",
    "utensil": "spoon fork knife spatula ladle whisk",
    "dish": "bowl plate cup mug pan",
    "furniture": "chair table sofa couch desk stool shelf cabinet bed lamp",
    "vehicle": "car truck bus van bike motorcycle airplane",
    "packaging": "box can bottle carton",
}
"""Wider names of things."""
SHAPES = {
    "vessel": "bowl cup mug pan pot glass vase jug dish container",
    "box": "carton package block cube brick book",
    "ball": "sphere orb apple orange",
    "cylinder": "can tin cup mug bottle jar tube",
    "disc": "plate lid dish saucer",
    "piece": "plate book stick pen spoon",
}
"""What an object without a label may be called by its shape in the scene graph."""
COMPOUNDS = {
    ("trash", "can"): "trashcan",
    ("garbage", "can"): "trashcan",
    ("frying", "pan"): "fryingpan",
    ("fry", "pan"): "frypan",
    ("teddy", "bear"): "teddybear",
    ("cell", "phone"): "cellphone",
    ("cheez", "it"): "cheezit",
    ("jell", "o"): "jello",
}
GROUND_NAMES = set(each("ground floor table tabletop desk surface counter countertop worktop worksurface"))
ANYTHING = set(each("one object thing item stuff body"))
FEW = set(each("scissors pliers glasses trousers jeans shorts headphones tongs goggles tweezers"))
"""Plural words for a single thing."""

_RELATED = [set(line.split()) for line in SYNONYMS.split("\n")]


def compounded(words: Sequence[str]) -> tuple[str, ...]:
    """Words with those of two parts as one."""
    joined: list[str] = []
    for word in words:
        if joined and (joined[-1], word) in COMPOUNDS:
            joined[-1] = COMPOUNDS[joined[-1], word]
        else:
            joined.append(word)
    return tuple(joined)


def singular(word: str) -> str:
    """``boxes`` is ``box``; a word that is no plural comes back."""
    if word in FEW or len(word) < 4 or word.endswith(("ss", "us", "is")) or not word.endswith("s"):
        return word
    if word.endswith("ies"):
        return word[:-3] + "y"
    if word.endswith(("xes", "ches", "shes", "sses", "zes")):
        return word[:-2]
    if word.endswith("ves"):
        return {"knives": "knife", "loaves": "loaf", "shelves": "shelf"}.get(word, word[:-1])
    return word[:-1]


def fit(names: Sequence[str], label: Sequence[str]) -> int | None:
    """How well names (the head noun last) fit a label's words: 0 its head noun, 1 words of it, 2 synonyms,
    3 a kind of things, None not at all."""
    wanted, had = [singular(w) for w in names], [singular(w) for w in label]
    if not had:
        return None
    if set(wanted) <= set(had):
        return 0 if wanted[-1] == had[-1] else 1
    if all(w in had or synonyms(w) & set(had) for w in wanted):
        return 2
    kinds = set(KINDS.get(wanted[-1], "").split())
    rest = all(w in had or synonyms(w) & set(had) for w in wanted[:-1])
    return 3 if rest and kinds & _with_synonyms(had) else None


def fits_shape(name: str, description: str) -> bool:
    """Whether something without a label may be called so, by its shape in the scene graph."""
    shape = description.partition(",")[0].split()[-1:]
    return bool(shape) and (name in shape or name in SHAPES.get(shape[0], "").split())


def synonyms(word: str) -> set[str]:
    """The other names of a thing."""
    found: set[str] = set()
    for line in _RELATED:
        if word in line:
            found |= line
    return found - {word}


def distance(a: str, b: str, most: int = 24) -> int:
    """Edits between two words: letters put in, left out, changed or swapped with their neighbour (optimal string
    alignment). Only so many first letters count."""
    a, b = a[:most], b[:most]
    rows = [list(range(len(b) + 1))]
    for i, x in enumerate(a, 1):
        row = [i]
        for j, y in enumerate(b, 1):
            best = min(rows[-1][j] + 1, row[-1] + 1, rows[-1][j - 1] + (x != y))
            if i > 1 and j > 1 and x == b[j - 2] and a[i - 2] == y:
                best = min(best, rows[-2][j - 2] + 1)
            row.append(best)
        rows.append(row)
    return rows[-1][-1]


def _with_synonyms(words: Iterable[str]) -> set[str]:
    return {s for w in words for s in synonyms(w) | {w}}
