"""Verbs that a goal may have: their families, all their forms, and those that ask for something else."""

from __future__ import annotations

from typing import Literal

from f3sr.language.grammar.normaliser import each

Family = Literal[
    "tip", "push", "pull", "hit", "collide", "roll", "drop", "put", "lift", "throw", "jump", "bounce", "fall", "return"
]
FAMILIES: dict[Family, str] = {
    "tip": "topple tip upset overturn capsize upend fell tumble overthrow flip",
    "push": "push shove move nudge slide shift kick poke press propel scoot tap send bring drive skid knock bump flick",
    "pull": "pull drag tug draw",
    "hit": "hit strike whack smack punch thump bash slap ram smash slam",
    "collide": "collide crash touch reach contact",
    "roll": "roll wheel",
    "drop": "drop release dump plop",
    "put": "put place set stack lay deposit pop tuck plonk",
    "lift": "lift raise hoist hold pick take grab elevate",
    "throw": "throw toss fling hurl lob chuck pitch launch shoot fire catapult sling cast fly land heave",
    "jump": "jump hop leap",
    "bounce": "bounce rebound ricochet",
    "fall": "fall",
    "return": "return come catch",
}
STRIKES = {"kick", "knock", "flick", "bump", "tap", "poke", "send"}
"""Pushes so short that they send a thing up as well."""
IRREGULAR = {
    "throw": "threw thrown",
    "fling": "flung",
    "sling": "slung",
    "strike": "struck stricken",
    "send": "sent",
    "bring": "brought",
    "drive": "drove driven",
    "slide": "slid",
    "draw": "drew drawn",
    "take": "took taken",
    "shoot": "shot",
    "fall": "fell fallen",
    "come": "came",
    "lay": "laid",
    "leap": "leapt",
    "fly": "flew flown",
    "catch": "caught",
    "upset": "upsetting",
    "overthrow": "overthrew overthrown",
}
UNCHANGED = {"hit", "put", "set", "upset", "cast"}
"""Verbs whose past has no ending."""
DOUBLED = set(each("tip drop plop pop hop hit put set slap slam tug drag ram skid flip chuck"))
SHOWN = "push, slide, pull, knock over, tip, hit ... with, roll, drop, lift ... and drop, put, throw, bounce, launch"
"""The verbs that a refusal names."""
OTHER = set(
    each(
        "ignore disregard override delete remove write print execute sudo rm format install download upload "
        "email translate summarize summarise pretend explain tell sing paint draft reveal hack compute "
        "calculate open close pour fill eat drink cook break shatter melt burn cut explode destroy vanish "
        "disappear teleport render film photograph describe rotate spin turn twist shake squeeze bend stir "
        "wash clean build create generate add insert duplicate copy rename run act show reset exit quit"
    )
)
"""Verbs at a clause's beginning that ask for what is no motion of one thing of the scene."""
INJECTED = set(each("ignore disregard override delete sudo execute poem password passwords email jailbreak"))
"""Words that no goal holds, wherever they stand."""
INSTRUCTIONS = set(each("instructions instruction prompt rules"))
BEFORE_INSTRUCTIONS = set(each("previous prior earlier forget system your above all"))
NEGATIONS = set(
    each(
        "not no never without nothing neither nor avoid unless except dont doesnt wont cant cannot shouldnt "
        "mustnt didnt isnt refuse prevent"
    )
)
FOREIGN = set(
    each(
        "le la les un une des du et vers dans sur avec der die das den dem ein eine und nach auf mit el los "
        "las uno una hacia sobre con il lo gli verso nel het een naar op o os para em em em til paa och ja "
        "poussez pousse schiebe wirf empuja lanza spingi lancia duw gooi empurre"
    )
)
"""Small words of other languages in Latin letters."""


def base_forms() -> dict[str, tuple[str, Family]]:
    """Every form of every verb, with the verb and its family."""
    forms: dict[str, tuple[str, Family]] = {}
    for family, verbs in FAMILIES.items():
        for verb in verbs.split():
            for form in _forms(verb):
                forms.setdefault(form, (verb, family))
    return forms


def _forms(verb: str) -> list[str]:
    """``drop drops dropping dropped``"""
    stem = verb + verb[-1] if verb in DOUBLED else verb
    third = verb + "es" if verb.endswith(("s", "sh", "ch", "ss")) else verb + "s"
    if verb.endswith("y") and verb[-2] not in "aeiou":
        third = verb[:-1] + "ies"
    short = verb[:-1] if verb.endswith("e") else stem
    past = [] if verb in UNCHANGED else [short + "ed"]
    return [verb, third, short + "ing", *past, *IRREGULAR.get(verb, "").split()]
