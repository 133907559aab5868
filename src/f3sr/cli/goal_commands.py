"""The commands for goals: simulate and goals. Exit codes: 0 met, 3 refused, 4 played but not met."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from f3sr.cli.arguments import (
    AgentChoice,
    Goals,
    MaybeFile,
    MaybeOut,
    MaybePackage,
    Model,
    Name,
    PackageFolder,
    RolloutFolder,
    Samples,
    Slow,
)
from f3sr.errors import F3srError, InputError, MissedError, OutputError, RefusedError, printable
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.kept_imports import kept_imports
from f3sr.runtime.progress import silent

if TYPE_CHECKING:
    from f3sr.agents.played_by_model import Agent
    from f3sr.film.studio import Studio
    from f3sr.goals.language_protocol import Language
    from f3sr.goals.plan import Plan
    from f3sr.goals.refusal import Refusal
    from f3sr.play.goal_loop import Played
    from f3sr.runtime.kernels import Compilers
    from f3sr.scene import Scene
    from f3sr.scene_package.package import Package

MOST = 100
"""Goals of one call."""


def simulate(
    package: PackageFolder,
    goals: Goals = (),
    /,
    out: MaybeOut = None,
    plan: MaybeFile = None,
    language: Name = None,
    model: Model = None,
    agent: AgentChoice = "roles",
    reasoner_model: Model = None,
    film: bool = True,
    slow: Slow = 1.0,
    samples: Samples = 0,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Play goals in plain words in a scene: plan, physics, verdict and film. Exit code 3: refused, 4: not met.

    Args:
        package: What ``f3sr reconstruct`` wrote.
        goals: What is to happen, in English, each in quotes: "knock over the mug". ``f3sr goals`` lists the objects.
        out: Where plan.json, rollout.npz, verdict.json and the film go; of several goals to its subfolders 1, 2, 3...
            Without it, to the next numbers in PACKAGE/rollouts.
        plan: A plan.json, or a rollout's folder, to play again instead of goals.
        language: Back end that understands goals; ``f3sr doctor`` lists its names. Without it: rules.
        model: Language model that plans instead: openai:NAME, anthropic:NAME, or openai:NAME@URL for any server that
            speaks OpenAI's API. Its key comes from OPENAI_API_KEY or ANTHROPIC_API_KEY.
        agent: With a model: roles asks Planner, Reasoner and Builder; direct asks for the whole plan at once.
        reasoner_model: Another model for the Reasoner.
        film: Make film.mp4, its key frames film.png and player.html too.
        slow: How many times slower than life the film is, 0.125 to 100.
        samples: Also play each plan in so many scenes that the photo may show as well, and tell the rate of success.
        overwrite: Also replace an older rollout.
        json: Print one JSON object instead of text.
    """
    with kept_imports():
        from f3sr.cli import console
        from f3sr.goals.refusal import Refusal
        from f3sr.play import rollout_folder
        from f3sr.play.languages import LANGUAGES, CheckedLanguage
        from f3sr.play.telling import telling
        from f3sr.runtime import kernels
        from f3sr.runtime.atomic_folder import recover
        from f3sr.scene_package.package import read_package
    recover(*(place for place in (package, out, plan) if place))
    _require_goals(goals, plan)
    spoken = CheckedLanguage(LANGUAGES.find(language)) if language else None
    ask = agent_of(model, agent, reasoner_model, language)
    _require_slow(slow)
    plan = plan and rollout_folder.plan_file(plan)
    content = read_package(package)
    drawn = _Samples.of(content, samples)
    places = _places(out, package, max(len(goals), 1), overwrite)
    tellings, failed, decided = list[dict[str, Any]](), None, set[str]()
    with kernels.compiling(film=film) as compilers:
        if film:
            _read_pictures(content)
        studio = begun(_studio_once, content, slow, compilers) if film else None  # beside the search for the first goal
        for played, place, goal, seconds in _played(content, goals, plan, ask or spoken, places, overwrite):
            tellings.append(telling(goal, played, place, seconds, replayed=plan is not None))
            if not json and (tellings[-1]["state"] != "refused" or len(goals) > 1):  # one refusal is the error's line
                _show(told_lines(tellings[-1]))
            if samples and not isinstance(played, Refusal):
                _finish(compilers, quiet=json)
                tellings[-1]["samples"] = rate = drawn.rate(played.plan, quiet=json)
                _show(() if json else [_rate_line(rate)])
            if studio is None or isinstance(played, Refusal) or place is None:
                continue
            try:
                _finish(compilers, quiet=json)
                tellings[-1]["film"] = told = filmed(studio.result, played, place)
            except F3srError as error:  # the rollout stands, and so do the other goals
                failed = failed or error
                tellings[-1]["film_error"] = str(error)
            else:
                _show(() if json else film_lines(told, decided))
                decided.update(told["decisions"])
    if json:
        console.print_json({"goals": tellings})
    if failed:
        raise failed
    _end(tellings)


def film(rollout: RolloutFolder, /, package: MaybePackage = None, slow: Slow = 1.0, json: bool = False) -> None:
    """Film a rollout again: film.mp4, its key frames film.png, and player.html to open in a browser.

    Args:
        rollout: A folder with plan.json and rollout.npz that ``f3sr simulate`` wrote. The film goes there and
            replaces the older film there.
        package: The package whose scene it plays; without it, the one that the rollout lies in.
        slow: How many times slower than life, 0.125 to 100.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.goals.verify import verify
    from f3sr.play import rollout_folder
    from f3sr.play.goal_loop import Played
    from f3sr.runtime import kernels

    _require_slow(slow)
    found = rollout_folder.read_played(rollout, package)
    place = rollout_folder.require_film_place(rollout)
    verdict = verify(found.package.scene, found.plan, found.rollout)
    played = Played(plan=found.plan, rollout=found.rollout, verdict=verdict)
    with kernels.compiling(film=True) as compilers:
        _finish(compilers, quiet=json)
        told = filmed(lambda: _studio(found.package, slow), played, place)
    if json:
        console.print_json(told)
    else:
        _show(film_lines(told, ()))


@dataclass(eq=False)
class _Samples:
    """Scenes that a package's photo may show as well, drawn when the first goal needs them."""

    content: Package
    count: int
    scenes: list[Scene] = field(default_factory=list["Scene"])

    @classmethod
    def of(cls, content: Package, count: int) -> _Samples:
        """Raises InputError at once where no samples can be drawn."""
        from f3sr.scene_samples import require_count, sample_scenes

        if count:
            require_count("--samples", count)
            sample_scenes(content, count)
        return cls(content, count)

    def rate(self, plan: Plan, *, quiet: bool) -> dict[str, Any]:
        from f3sr.cli import console
        from f3sr.play.sample_rollouts import success_rate
        from f3sr.scene_samples import sample_scenes

        if not self.scenes:
            with console.steps_shown(quiet=quiet) as progress:
                self.scenes += [d.sample.scene for d in sample_scenes(self.content, self.count, progress=progress)]
        if not self.scenes:
            raise F3srError(f"no sample of {self.content.folder} rests on its masks")
        found = success_rate(plan, self.scenes)
        return {
            "wanted": self.count,
            "count": found.count,
            "met": found.met,
            "rate": found.rate,
            "interval": list(found.interval),
            "missed": {str(k): said for k, said in found.missed.items()},
        }


def _rate_line(rate: dict[str, Any]) -> str:
    low, high = rate["interval"]
    why = f"; sample {next(iter(rate['missed']))}: {next(iter(rate['missed'].values()))}" if rate["missed"] else ""
    few = f" (of {rate['wanted']} wanted)" if rate["count"] < rate["wanted"] else ""
    return (
        f"samples:   met in {rate['met']} of {rate['count']}{few}, "
        f"90 % interval {100 * low:.0f} to {100 * high:.0f} %{why}"
    )


def _read_pictures(content: Package) -> None:
    """What a film needs of a package, before a goal is played for it: a damaged file ends the command here."""
    for read in (content.background, content.support, content.kept_depth):
        read()


def _finish(compilers: Compilers, *, quiet: bool) -> None:
    """Say so where the kernels of the first film have to be waited for."""
    from f3sr.cli import console

    if compilers.busy:
        with console.steps_shown(quiet=quiet) as progress:
            compilers.finish(progress)


def _show(lines: Iterable[str]) -> None:
    for line in lines:
        print(printable(line), flush=True)


def _require_slow(slow: float) -> None:
    from f3sr.film.slow_motion import factor

    factor(slow)


def _studio_once(content: Package, slow: float, compilers: Compilers) -> Studio:
    """The studio as soon as its kernels are compiled: numba lets nobody else begin with one while it waits for one."""
    compilers.finish(silent)
    return _studio(content, slow)


def _studio(content: Package, slow: float) -> Studio:
    from f3sr.film.studio import FilmConfig, Studio

    return Studio.of(content, FilmConfig(slow=slow))


def filmed(studio: Callable[[], Studio], played: Played, place: Path) -> dict[str, Any]:
    """Film what was played, write it, and tell of it as plain values."""
    from f3sr.goals.file_names import FILM
    from f3sr.play.rollout_folder import write_film

    start = time.perf_counter()
    made = studio().film(played)
    write_film(made.files, place)
    return {
        "file": str(place / FILM),
        "frames": made.frames,
        "size": list(made.size),
        "seconds": round(time.perf_counter() - start, 3),
        "decisions": list(made.decisions),
    }


def film_lines(told: dict[str, Any], known: Container[str]) -> Iterator[str]:
    """What was decided for a film, but for what is ``known``, and where it is."""
    from f3sr.goals.file_names import PLAYER

    yield from (f"decided:   {decision}" for decision in told["decisions"] if decision not in known)
    width, height = told["size"]
    yield f"film:      {told['file']}, {told['frames']} frames of {width}x{height}, {told['seconds']:.1f} s"
    yield f"to play:   {Path(told['file']).with_name(PLAYER)}"


def goals(package: PackageFolder, /, json: bool = False) -> None:
    """List what can be asked of a scene: its objects, with words that select them and verbs that make sense.

    Args:
        package: What ``f3sr reconstruct`` wrote.
        json: Print one JSON object instead of text.
    """
    from dataclasses import asdict

    from f3sr.cli import console
    from f3sr.language.capabilities import menu
    from f3sr.scene_package.package import read_package

    entries = menu(read_package(package).scene)
    if json:
        console.print_json({"objects": [asdict(e) for e in entries]})
        return
    rows = [
        (str(e.id), printable(e.name), ", ".join(e.verbs) or "fixed", "holds things" if e.holds_things else "")
        for e in entries
    ]
    console.print_table(rows, header=("id", "say", "verbs", ""))


def agent_of(model: str | None, agent: AgentChoice, reasoner: str | None, language: str | None) -> Agent | None:
    """The models that play goals; raises InputError where options contradict each other."""
    if model is None:
        if reasoner is not None or agent != "roles":
            raise InputError("simulate", found="--agent or --reasoner-model alone", accepted="with --model")
        return None
    if language is not None:
        raise InputError("simulate", found="--model and --language", accepted="one of them")
    from f3sr.agents.played_by_model import Agent

    return Agent.of(model, agent, reasoner)


def _require_goals(goals: Sequence[str], plan: Path | None) -> None:
    if bool(goals) == (plan is not None):
        found = "both goals and --plan" if goals else "no goal"
        raise InputError("simulate", found=found, accepted='a goal in quotes, as "knock over the mug", or --plan FILE')
    if len(goals) > MOST:
        raise InputError("simulate", found=f"{len(goals)} goals", accepted=f"at most {MOST}")


def _places(out: Path | None, package: Path, count: int, overwrite: bool) -> list[Path] | list[None]:
    """Where rollouts go, checked; None for the package's next number."""
    from f3sr.play.rollout_folder import PLAN, require_next, require_place

    if out is None:
        require_next(package)
        return [None] * count
    if count == 1:
        return [require_place(out, package, overwrite=overwrite)]
    if (out / PLAN).exists():
        raise OutputError(f"{out}: holds one rollout, and {count} goals go to subfolders; give another folder")
    return [require_place(out / str(k + 1), package, overwrite=overwrite) for k in range(count)]


def _played(
    content: Package,
    goals: Sequence[str],
    plan: Path | None,
    language: Agent | Language | None,
    places: Sequence[Path | None],
    overwrite: bool,
) -> Iterator[tuple[Played | Refusal, Path | None, str, float]]:
    """Every goal played and written as soon as it is, with its place, words and seconds."""
    from f3sr.agents.played_by_model import Agent
    from f3sr.goals.refusal import Refusal
    from f3sr.play.goal_loop import replay_plan, simulate_goal
    from f3sr.play.rollout_folder import read_plan, write_next, write_played

    read = None if plan is None else read_plan(plan)
    for goal, place in zip([read.goal] if read else goals, places, strict=True):
        start = time.perf_counter()
        if read is not None and plan is not None:
            try:
                played = replay_plan(content, read)
            except F3srError as error:
                raise InputError(plan, found=str(error), accepted="a plan of this package's scene") from None
        else:
            by_models = isinstance(language, Agent)
            played = language.simulate(content, goal) if by_models else simulate_goal(content, goal, language=language)
        if not isinstance(played, Refusal):
            place = (
                write_next(played, content.folder)
                if place is None
                else write_played(played, place, overwrite=overwrite)
            )
        yield played, place, goal, time.perf_counter() - start


def told_lines(told: dict[str, Any]) -> Iterator[str]:
    yield f"goal:      {told['goal']}"
    if told["state"] == "refused":
        yield f"refused:   {told['message']}"
        return
    for k, phase in enumerate(told["phases"], 1):
        if len(told["phases"]) > 1:
            yield f"phase {k}:"
        yield f"meaning:   {phase['interpretation']}"
        yield from (f"assumed:   {assumed}" for assumed in phase["assumptions"])
        yield f"launch:    {phase['launch']}"
        for c in phase["conditions"]:
            yield f"{'met:   ' if c['met'] else 'missed:'}    {c['said']}"
    if told["stopped"]:
        yield "not played: the phases after it, as this one is missed"
    yield from (f"also:      {effect}" for effect in told["side_effects"])
    yield from (f"broken:    {rule}" for rule in told["broken_rules"])
    yield from [f"nearest:   {told['nearest']}"] if told["nearest"] else []
    if told["calls"]:
        yield f"models:    {_asked(told['calls'])}"
    yield f"verdict:   {told['state']}, {_counted(told['rollouts'])}, {told['seconds']:.1f} s"
    yield f"written:   {told['folder']}"


def _asked(calls: Sequence[dict[str, Any]]) -> str:
    """What a goal cost."""
    tokens = sum(c["input_tokens"] + c["output_tokens"] for c in calls)
    costs = [c["cost"] for c in calls if c["cost"] is not None]
    cost = f", {sum(costs):.4f} USD" if len(costs) == len(calls) else ""
    names = ", ".join(dict.fromkeys(c["model"] for c in calls))
    return f"{names}: {len(calls)} calls, {tokens:,} tokens{cost}, {sum(c['seconds'] for c in calls):.1f} s"


def _counted(rollouts: int) -> str:
    return "1 rollout" if rollouts == 1 else f"{rollouts} rollouts"


def _end(tellings: Sequence[dict[str, Any]]) -> None:
    """Raises for the exit code."""
    for state, error in (("refused", RefusedError), ("missed", MissedError)):
        if some := [t for t in tellings if t["state"] == state]:
            missed = [
                *some[0].get("broken_rules", []),
                *(c["said"] for p in some[0].get("phases", ()) for c in p["conditions"] if not c["met"]),
            ]
            said = some[0].get("message") or "; ".join([*missed, *filter(None, [some[0]["nearest"]])])
            more = f" (and {len(some) - 1} more)" if len(some) > 1 else ""
            raise error(f"{'refused' if state == 'refused' else 'not met'}: {said}{more}")
