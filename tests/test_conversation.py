"""Talks about a scene: a goal a line, and what short lines make of the goal before."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest

from f3sr.cli.main import main
from f3sr.language.grammar.parser import understand
from f3sr.language.grammar.request import Request
from f3sr.play.conversation import Conversation, Wish
from goal_scene import goal_package
from laid_table import table


def after(*lines: str) -> Wish | str:
    talk = Conversation(table())
    return [talk.heard(line) for line in lines][-1]


def goal(*lines: str) -> str:
    found = after(*lines)
    assert isinstance(found, Wish), found
    return found.goal


def request(text: str) -> Request:
    found = understand(text)
    assert isinstance(found, tuple), found
    return found[0]


def test_again_is_the_same_goal() -> None:
    first = "push the red mug to the left"
    assert goal(first) == goal(first, "again") == goal(first, "objects", "Again!") == first


@pytest.mark.parametrize("text", ["push the red mug to the left", "push the red mug hard to the left."])
def test_slower_and_faster_change_the_manner(text: str) -> None:
    plain = request("push the red mug to the left")
    for line, manner in (
        ("slower", "gently"),
        ("a bit more gently", "gently"),
        ("harder!", "hard"),
        ("faster", "hard"),
    ):
        found = request(goal(text, line))
        assert found.manner == manner and (found.kind, found.active) == (plain.kind, plain.active)
    assert goal(text, "slower", "slower") == goal(text, "slower")


def test_after_a_refused_manner_the_goal_before_it_stands() -> None:
    talk = Conversation(table())
    for line in ("push the bottle to the left", "push the red mug to the left", "slower"):
        talk.heard(line)
    talk.refused()
    assert talk.heard("again") == Wish(goal="push the red mug to the left", slow=1)


def test_slower_changes_the_first_of_several_phases() -> None:
    found = understand(goal("push the red mug to the left, then topple the bottle", "slower"))
    assert isinstance(found, tuple) and [r.manner for r in found] == ["gently", None]


def test_the_other_one_is_set_off_instead() -> None:
    for line in ("the other mug", "No, the other one", "now with the other mug"):
        found = request(goal("push the red mug to the left", line))
        assert "mug" in found.active and "red" not in found.active and found.direction == ("left",)
    there_and_back = goal("push the red mug to the left", "the other mug", "the other mug")
    assert request(there_and_back).active == "red mug"
    assert "not understood" in str(after("push the bowl to the left", "the other bowl"))


def test_films_may_be_slow() -> None:
    found = after("push the red mug to the left", "slow motion")
    assert isinstance(found, Wish) and found.slow == 2
    found = after("push the red mug to the left", "slow motion", "slow motion", "real time")
    assert isinstance(found, Wish) and found.slow == 1


@pytest.mark.parametrize("line", ["again", "slower", "the other mug"])
def test_without_a_goal_nothing_is_played(line: str) -> None:
    assert "nothing was played yet" in str(after(line))


def test_a_refused_goal_is_forgotten() -> None:
    talk = Conversation(table())
    talk.heard("push the red mug to the left")
    talk.heard("fly")
    talk.refused()
    assert talk.heard("again") == Wish(goal="push the red mug to the left", slow=1.0)


def test_a_talk_on_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    package = goal_package(tmp_path / "package")
    lines = [
        "push the wooden block 5 cm to the left",
        "slower",
        "",
        "fly\x1b[31m",
        "\x00" * 3,
        "again",
        "quit",
        "never",
    ]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines)))
    assert main(["chat", str(package.folder), "--no-film"]) == 0
    out = capsys.readouterr().out
    assert out.count("verdict:   met") == 3 and out.count("refused:") == 2 and "never" not in out
    assert len(list((package.folder / "rollouts").iterdir())) == 3
    assert all(c.isprintable() or c == "\n" for c in out) and not re.search("Traceback", out)
