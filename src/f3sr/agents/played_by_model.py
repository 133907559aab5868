"""A goal played by models: the goal loop with their language, and what the calls were, noted in the plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Self

from f3sr.agents.model_language import AgentConfig, Direct, Roles
from f3sr.agents.role_answers import AgentName
from f3sr.goals.plan import ModelCall, Plan
from f3sr.goals.refusal import Refusal
from f3sr.models.model_client import ModelClient, ModelConfig
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.scene_package.package import Package


@dataclass(frozen=True, eq=False)
class Agent:
    """Models that play goals: their language, and the clients that it asks."""

    language: Roles | Direct
    clients: tuple[ModelClient, ...]

    @classmethod
    def of(
        cls,
        model: str,
        agent: AgentName = "roles",
        reasoner_model: str | None = None,
        *,
        config: AgentConfig | None = None,
        model_config: ModelConfig | None = None,
    ) -> Self:
        """The agent of specs of models. Raises InputError for bad ones, and without the extra ``llm``."""
        client = ModelClient.of(model, model_config)
        if agent == "direct":
            return cls(Direct(client, config), (client,))
        other = ModelClient.of(reasoner_model, model_config) if reasoner_model else None
        clients = (client, other) if other else (client,)
        return cls(Roles(client, other, config), clients)

    def simulate(self, package: Package, goal: str) -> Played | Refusal:
        """``simulate_goal`` by these models."""
        before = [len(client.calls) for client in self.clients]

        def new() -> list[ModelCall]:
            made = zip(self.clients, before, strict=True)
            return [ModelCall(**asdict(call)) for client, count in made for call in client.calls[count:]]

        return simulate_with_models(package, goal, self.language, new)


def simulate_with_models(
    package: Package, goal: str, language: Roles | Direct, calls: Callable[[], Sequence[ModelCall]]
) -> Played | Refusal:
    """``simulate_goal`` with a language of models. The plan notes the ``calls`` of this goal, and where properties
    differ much from the table's. Raises ModelError where a model gives no answer that suits."""
    played = simulate_goal(package, goal, language=language)
    if isinstance(played, Refusal):
        return played
    return replace(played, plan=_noted(played.plan, tuple(calls()), language.notes))


def _noted(plan: Plan, calls: tuple[ModelCall, ...], notes: Sequence[str]) -> Plan:
    first, *rest = plan.phases
    task = first.task.model_copy(update={"assumptions": (*first.task.assumptions, *notes)})
    return plan.model_copy(
        update={"calls": calls, "phases": (first.model_copy(update={"task": task}), *rest)},
    )
