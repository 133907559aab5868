"""The commands for agents and talks: mcp and chat."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from f3sr.cli.arguments import AgentChoice, Model, PackageFolder
from f3sr.errors import F3srError, printable

if TYPE_CHECKING:
    from f3sr.film.studio import Studio
    from f3sr.play.conversation import Conversation, Wish
    from f3sr.scene_package.package import Package

RequiredModel = Annotated[str, arg(metavar="MODEL")]
RootFolder = Annotated[Path, arg(metavar="FOLDER")]


def mcp(root: RootFolder) -> None:
    """Serve scenes as tools of the Model Context Protocol, over standard input and output. Needs the extra llm.

    Args:
        root: The one folder in which agents may read and write.
    """
    from f3sr.mcp_server.allowed_root import AllowedRoot
    from f3sr.mcp_server.scene_tools import SceneTools
    from f3sr.mcp_server.server import make_server

    make_server(SceneTools(AllowedRoot.of(root))).run("stdio")


def chat(
    package: PackageFolder,
    /,
    model: Model = None,
    agent: AgentChoice = "roles",
    reasoner_model: Model = None,
    film: bool = True,
) -> None:
    """Talk to a scene: a goal a line from standard input, then again, slower, or the other mug. Lines end with quit.

    Args:
        package: What ``f3sr reconstruct`` wrote.
        model: Language model that plans, as of ``f3sr simulate``. Without it: rules.
        agent: With a model: roles asks Planner, Reasoner and Builder; direct asks for the whole plan at once.
        reasoner_model: Another model for the Reasoner.
        film: Film every goal.
    """
    from f3sr.cli.goal_commands import agent_of
    from f3sr.play.conversation import HELP, Conversation
    from f3sr.scene_package.package import read_package

    by_models = agent_of(model, agent, reasoner_model, None)
    content = read_package(package)
    talk, player = Conversation(content.scene), _Player(content, by_models, film)
    print(HELP, flush=True)
    while not talk.ended:
        print("> ", end="", flush=True)
        line = sys.stdin.readline(MOST_CHARACTERS)
        if not line:
            return
        heard = talk.heard(line.rstrip("\n"))
        try:
            for said in heard.split("\n") if isinstance(heard, str) else player.played(heard, talk):
                print(printable(said), flush=True)
        except F3srError as error:  # the talk goes on
            print(printable(f"failed:    {error}"), flush=True)


def materials(package: PackageFolder, /, model: RequiredModel, overwrite: bool = False, json: bool = False) -> None:
    """Let a vision model estimate what every object is made of, and write that into the package.

    Args:
        package: What ``f3sr reconstruct`` wrote. scene.json and the exporters' files change.
        model: The model, as of ``f3sr simulate``.
        overwrite: Also where rollouts are, which belong to the scene as it was.
        json: Print one JSON object instead of text.
    """
    from f3sr.agents.package_materials import estimated, write_materials
    from f3sr.cli import console
    from f3sr.models.model_client import ModelClient
    from f3sr.scene_package.package import read_package

    client, content = ModelClient.of(model), read_package(package)
    found = estimated(content.scene, client, str(client.endpoint))
    write_materials(content, found, client.calls, overwrite=overwrite)
    rows = [(o.id, o.label, o.material, o.density, o.friction, o.restitution, o.material_source) for o in found.scene]
    if json:
        names = ("id", "label", "material", "density", "friction", "restitution", "source")
        told = {"objects": [dict(zip(names, row, strict=True)) for row in rows], "kept": list(found.kept)}
        console.print_json(told | {"disagreements": list(found.disagreements)})
        return
    console.print_table(
        [(str(id), printable(label), printable(made), *(f"{v:.4g}" for v in values), source)
         for id, label, made, *values, source in rows],
        header=("id", "object", "material", "kg/m3", "friction", "restitution", "from"),
    )  # fmt: skip
    for said in found.disagreements:
        console.say(f"differs: {said}")
    for id in found.kept:
        console.say(f"fallback: object {id} would not rest with the model's properties and keeps its own")


MOST_CHARACTERS = 4000
"""Longest line that is read."""


class _Player:
    """Plays wishes into a package's rollouts, one studio for all films of a pace."""

    def __init__(self, content: Package, by_models: object, film: bool) -> None:
        self.content, self.by_models, self.film = content, by_models, film
        self.studios: dict[float, Studio] = {}

    def played(self, wish: Wish, talk: Conversation) -> list[str]:
        """What is to be told of a goal."""
        from f3sr.agents.played_by_model import Agent
        from f3sr.cli.goal_commands import film_lines, filmed, told_lines
        from f3sr.film.studio import FilmConfig, Studio
        from f3sr.goals.refusal import Refusal
        from f3sr.play.goal_loop import simulate_goal
        from f3sr.play.rollout_folder import write_next
        from f3sr.play.telling import telling

        start, ask = time.perf_counter(), self.by_models
        played = (
            ask.simulate(self.content, wish.goal) if isinstance(ask, Agent) else simulate_goal(self.content, wish.goal)
        )
        place = None if isinstance(played, Refusal) else write_next(played, self.content.folder)
        told = list(told_lines(telling(wish.goal, played, place, time.perf_counter() - start, replayed=False)))
        if isinstance(played, Refusal):
            talk.refused()
        if isinstance(played, Refusal) or place is None or not self.film:
            return told
        if wish.slow not in self.studios:
            self.studios[wish.slow] = Studio.of(self.content, FilmConfig(slow=wish.slow))
        return [*told, *film_lines(filmed(lambda: self.studios[wish.slow], played, place), ())]
