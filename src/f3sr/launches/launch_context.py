"""What the Builder knows when it sets something off: the task in numbers, and how to push, throw or lift the object."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from f3sr.core.transforms import UP, Array
from f3sr.goals.cavity import Cavity
from f3sr.goals.language_protocol import Launch, Tried
from f3sr.goals.launch_limits import WHIRL, whirl
from f3sr.goals.plan import (
    Bounced,
    Contact,
    Impulse,
    InitialConditions,
    Limits,
    Offset,
    SimulationPlan,
    TaskSpec,
    Velocity,
)
from f3sr.goals.scene_layout import SceneLayout
from f3sr.launches.ballistics import height_speed
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import GRAVITY, GROUND

SLIPPERY = 0.01
"""Least coefficient of friction that a launch is planned with: ice on ice has .02."""
RAMP = 0.1
"""How long a push takes to bring something to its pace [s]: a step of velocity would lift it (see ``BLOW``)."""
BLOW = 0.02
"""Duration of an impulse along the ground [s].

The engine's friction cone is convex, so a velocity step lifts a sliding object: by 12 mm at 4 m/s. This lifts by .2
mm."""
STANDS = 0.9
"""Share of the angle of tipping by friction up to which something is pushed at any pace."""
CALM = 0.75
"""Share of the speed that tips something over at which it is pushed otherwise."""
SPARE = 0.02
"""Share of the largest force that is left to bring something to its pace, however much its friction takes."""
LOADED = 1.05
"""Ratio of mass with what lies on it to its own from which on something is pushed with its load, not struck,"""
CARRIES = 0.8
"""and share of friction that bringing it to its pace takes at most, so that the load does not slip."""
AT_ONCE = 0.12
"""Before this [s] something that is thrown is not yet gone."""
CLEARANCE = 0.006
"""Least height [m] over what an object is let go above."""

Result = TypeVar("Result")

Search = Generator[Sequence[Launch], Sequence[Tried], Result]
"""Yields launches to be tried, is sent what came of each, returns its result."""
Launches = Search[None]


@dataclass(eq=False)
class Aim:
    """How far to aim for something to go so far: corrected in proportion until it is between two, then halved."""

    goal: float
    most: float = 1.8
    """Largest factor by which an aim changes from one trial to the next."""
    far: float = 0.0
    """Where to aim now."""
    near: float = 0.0
    """Farthest aim that fell short."""
    beyond: float = math.inf
    """Nearest aim that went too far."""

    def __post_init__(self) -> None:
        self.far = self.far or self.goal

    def ended(self, moved: float) -> None:
        """Correct the aim: with the last one the object ``moved`` so far [m]."""
        if moved < self.goal:
            self.near = max(self.near, self.far)
        else:
            self.beyond = min(self.beyond, self.far)
        wanted = self.far * float(np.clip(self.goal / max(moved, 0.05 * self.goal), 1 / self.most, self.most))
        inside = self.near < wanted < self.beyond
        self.far = wanted if inside else math.sqrt(max(self.near, 0.1 * self.beyond) * self.beyond)


@dataclass(frozen=True, eq=False)
class LaunchContext:
    """A task on a scene of objects as the plan makes them."""

    task: TaskSpec
    layout: SceneLayout
    limits: Limits

    @property
    def active(self) -> int:
        """Id of the object that is launched."""
        return self.task.active

    @property
    def target(self) -> int | None:
        """The target, unless it is the ground."""
        return None if self.task.target == GROUND else self.task.target

    @cached_property
    def floor(self) -> int:
        """What it bounces off on its way to a target: what its task tells, else what it and the target stand on."""
        told = (c.b for c in self.task.conditions if isinstance(c, Bounced | Contact) and c.a == self.active)
        both = GROUND if self.target is None else self.layout.floor_of(self.active, self.target)
        return next((b for b in told if b != self.task.target), both)

    @cached_property
    def low(self) -> float:
        """Height [m] of its centre of mass where it touches that floor, midway to the target if that is in sight."""
        if self.floor == GROUND or self.target is None:
            return self.height
        here, there = self.center[:2], self.layout.center(self.target)[:2]
        tops = [self.layout.top(*(here + k * (there - here)).tolist(), without=self.active) for k in (0.5, 0.35, 0.65)]
        top = next((z for z, whose in tops if whose == self.floor), float(self.layout.span(self.floor)[1, 2]))
        return min(top + self.height, float(self.center[2]))

    @cached_property
    def direction(self) -> Array:
        """Unit vector (3,) of the task's direction in the world, level; x where the task names none."""
        d = np.array(self.task.direction or (1.0, 0.0, 0.0)) * [1, 1, 0]
        return d / max(float(np.linalg.norm(d)), 1e-12)

    @cached_property
    def center(self) -> Array:
        """Centre of mass (3,) of the active object in the world [m]."""
        return self.layout.center(self.active)

    @cached_property
    def height(self) -> float:
        """Height [m] of the centre of mass above the object's lowest point."""
        return float(self.center[2] - self.layout.span(self.active)[0, 2])

    @cached_property
    def size(self) -> float:
        """Size of the active object [m], the unit of most heights and aims."""
        return self.layout.size(self.active)

    @cached_property
    def drag(self) -> float:
        """Deceleration by friction on level ground [m/s2]: mu g. On ice launches are planned with a little more: no
        push ends there."""
        return max(self.layout.friction(self.active), SLIPPERY) * GRAVITY

    @cached_property
    def pool(self) -> Cavity | None:
        """What it lies in, where that is something."""
        below = self.layout.support(self.active)
        return None if below == GROUND else self.layout.pool(below)

    @cached_property
    def start(self) -> tuple[Array, Array | None]:
        """Where the centre of mass is when it is thrown, and the lift (3,) that takes it there: out of what it lies
        in, or from under what lies on it."""
        low = float(self.layout.span(self.active)[0, 2])
        over = [z for z, _ in self.layout.under(self.active, np.zeros(2), reach=(0.4, 0.8)) if z > self.center[2]]
        up = float(np.max([low, *over, *([self.pool.level] if self.pool else [])])) - low
        if up <= 2e-3:
            return self.center, None
        lift = (up + CLEARANCE) * UP
        return self.center + lift, lift

    @cached_property
    def raised(self) -> tuple[Array, Array]:
        """The same above all that is beside it and may hold it back."""
        beside = self.layout.under(self.active, np.zeros(2), reach=(1.1, 1.4))
        tops = [z for z, whose in beside if whose != self.target]
        lift = (max(*tops, 0.0) + CLEARANCE - float(self.layout.span(self.active)[0, 2])) * UP
        return self.center + lift, lift

    def hindered(self, tried: Tried) -> bool:
        """Whether it met anything but its target and what it stood on before it was gone."""
        contacts = tried.rollout.contacts
        early = contacts[contacts["time"] < AT_ONCE]
        met = {int(b if a == self.active else a) for _, a, b, _ in early if self.active in (a, b)}
        return bool(met - {GROUND, self.target, self.layout.support(self.active)})

    @property
    def hard(self) -> float:
        """Factor on speeds by the goal's manner, as "gently"."""
        return {"gently": 0.6, "hard": 1.7}.get(self.task.manner or "", 1.0)

    def calm(self, direction: Array) -> float:
        """The speed up to which the object does not tip over when friction stops it [m/s]."""
        corners = self.layout.corners(self.active)
        base = corners[corners[:, 2] <= corners[:, 2].min() + 0.1 * self.height]
        ahead = max(float(((base - self.center) @ direction).max()), 1e-6)
        # Friction mu m g at the ground turns it over the edge ahead once mu h exceeds that edge's distance.
        if self.drag / GRAVITY * self.height < STANDS * ahead:
            return math.inf
        # Energy that lifts the centre over the edge: v^2 / 2 = g (|arm| - h).
        return CALM * math.sqrt(2 * GRAVITY * (math.hypot(ahead, self.height) - self.height))

    # --- launches -----------------------------------------------------------------------------------------------------

    def thrown(
        self, linear: Array, *, angular: Array | None = None, lift: Array | None = None, seconds: float
    ) -> Launch:
        """A launch with a velocity of the centre of mass (3,) [m/s] and an angular velocity (3,) [rad/s], within the
        limits.

        If a ``lift`` (3,) is needed first, it starts from the top of a hop."""
        speed = float(np.linalg.norm(linear))
        most = min(self.limits.speed, self.limits.impulse / self.layout.mass(self.active))
        turning = np.zeros(3) if angular is None else angular
        whirls = whirl(self.layout.scene[self.active], turning)
        # Both velocities by one factor: their ratio, as of rolling, stays.
        share = min(1.0, most / max(speed, 1e-12), WHIRL * self.limits.speed / max(whirls, 1e-12))
        linear, turning = share * linear, share * turning
        if lift is not None:
            return self._hopped(linear, turning, float(lift[2]), seconds)
        velocity = Velocity(id=self.active, linear=_three(linear), angular=_three(turning))
        return self._launch(InitialConditions(velocities=(velocity,)), seconds)

    def _hopped(self, linear: Array, angular: Array, height: float, seconds: float) -> Launch:
        """Knocked upwards, and off with a speed when it is so high [m]: the scene starts as it is."""
        mass, up = self.layout.mass(self.active), height_speed(height)
        spin = self.layout.inertia(self.active) @ angular
        blows = (
            Impulse(id=self.active, time=0.0, linear=_three(mass * up * UP)),
            Impulse(id=self.active, time=up / GRAVITY, linear=_three(mass * linear), angular=_three(spin)),
        )
        return self._launch(InitialConditions(impulses=blows), seconds + up / GRAVITY)

    def struck(self, direction: Array, speed: float, until: float, *, seconds: float) -> Launch:
        """An impulse along the ground to a speed, which ends before the object has moved by ``until`` [m].

        It acts so low that it and friction together have no torque."""
        mass, speed = self.layout.mass(self.active), min(speed, self.limits.speed)
        duration = max(BLOW, mass * speed / (0.9 * self.limits.force))
        # Under constant force the object moves by v t / 2 meanwhile: 1.6 leaves a fifth of the way free.
        duration = min(duration, 1.6 * max(until, 0.0) / max(speed, 1e-9))
        if duration < 1e-3:
            return self.thrown(speed * direction, seconds=seconds)
        friction = min(mass * self.drag, self.limits.force) * duration
        J = min(friction + mass * speed, self.limits.force * duration) * direction
        turn = np.cross([0.0, 0.0, -self.height], friction * direction)
        blow = Impulse(id=self.active, time=0.0, duration=duration, linear=_three(J), angular=_three(turn))
        return self._launch(InitialConditions(impulses=(blow,)), seconds)

    def lifted(self, lift: Array, *, seconds: float) -> Launch:
        """A launch that lets it go at an offset (3,) [m] from where it is."""
        offset = Offset(id=self.active, translation=_three(lift))
        return self._launch(InitialConditions(offsets=(offset,)), seconds)

    def pushed(self, direction: Array, far: float, pace: float, *, until: float = math.inf) -> Launch:
        """A steady push to a pace and then against friction, so that the object rests after about ``far`` [m].

        The push ends before it has moved by ``until`` [m]. It acts so low that it and friction together have no torque.
        Objects in the path are pushed along.
        """
        far = max(far, 1e-3)
        pace = max(pace, far / LONGEST_PUSH)
        a, mass, seconds = self.drag, self.layout.loaded_mass(self.active), far / max(pace, 0.05) + 2.5
        spare = max(self.limits.force - mass * a, SPARE * self.limits.force)
        pace = min(pace, math.sqrt(2 * a * far), min(self.limits.force / 2, spare) * RAMP / mass)
        if mass > LOADED * self.layout.mass(self.active):
            pace = min(pace, CARRIES * a * RAMP, a * (math.sqrt((RAMP / 2) ** 2 + 2 * far / a) - RAMP / 2))
        # The way at even pace: without what it slides after the push, and without the ramp's.
        rest = far - pace**2 / (2 * a) - pace * RAMP / 2
        rest = min(rest, until - pace * RAMP / 2, pace * LONGEST_PUSH)
        if rest < 0:
            start = math.sqrt(2 * a * far) if until > far else math.sqrt(pace**2 + 2 * a * until)
            return self.struck(direction, start, until, seconds=seconds)
        seconds = max(seconds, RAMP + rest / pace + RESTS)
        low = np.array([0.0, 0.0, -self.height])
        friction = min(mass * a, self.limits.force - spare) * direction
        ramp = Impulse(
            id=self.active,
            time=0.0,
            duration=RAMP,
            linear=_three((friction + mass * pace / RAMP * direction) * RAMP),
            angular=_three(np.cross(low, friction * RAMP)),
        )
        pushes = [ramp]
        for begin, end, load in self._stretches(direction, pace * RAMP / 2, pace * RAMP / 2 + rest):
            time, duration = RAMP + (begin - pace * RAMP / 2) / pace, (end - begin) / pace
            force = (mass * a + load) * direction
            force = force * min(1.0, self.limits.force / max(float(np.linalg.norm(force)), 1e-12))
            J = force * duration
            pushes.append(
                Impulse(
                    id=self.active, time=time, duration=duration, linear=_three(J), angular=_three(np.cross(low, J))
                )
            )
        return self._launch(InitialConditions(impulses=tuple(p for p in pushes if p.duration > 1e-3)), seconds)

    def _stretches(self, direction: Array, begin: float, end: float) -> list[tuple[float, float, float]]:
        """Where on a way [m] the push has how much more to move [N], for what is met."""
        met = [(way, i) for way, i in self.layout.meets(self.active, direction) if way < end and i != self.target]
        met = [(way, i) for way, i in met if self.layout.scene[i].mobility == "dynamic"]
        stops = [begin, *(max(way, begin) for way, _ in met), end]
        loads = np.cumsum([0.0, *(self.layout.friction(i) * self.layout.loaded_mass(i) * GRAVITY for _, i in met)])
        return [(u, v, float(load)) for u, v, load in zip(stops, stops[1:], loads, strict=False) if v - u > 1e-4]

    def _launch(self, initial: InitialConditions, seconds: float) -> Launch:
        simulation = SimulationPlan(duration=min(max(seconds, 0.5), LONGEST), limits=self.limits)
        return Launch(initial=initial, simulation=simulation)

    # --- what came of them ------------------------------------------------------------------------------------------

    def way(self, tried: Tried, id: int | None = None) -> Array:
        """(T, 3) way of an object's centre of mass in the world [m], the active one's by default."""
        id = self.active if id is None else id
        T = tried.rollout.poses(id)
        return T[:, :3, :3] @ body_of(self.layout.scene[id]).center + T[:, :3, 3]

    def moved(self, tried: Tried) -> float:
        """How far it is along the direction at the end, from where the package has it [m]."""
        return float((self.way(tried)[-1] - self.center) @ self.direction)

    def lean(self, tried: Tried) -> float:
        """Angle [rad] between the object's upright axis at the start and at the end."""
        R = tried.rollout.poses(self.active)[[0, -1], :3, :3]
        return float(np.arccos(np.clip((R[1] @ R[0].T)[2, 2], -1, 1)))

    def rolling(self, linear: Array) -> Array:
        """The angular velocity (3,) [rad/s] with which it rolls at a velocity (3,) [m/s] and does not slide: up x v /
        h."""
        return np.asarray(np.cross(UP, linear) / max(self.height, 1e-6), float)


LONGEST, LONGEST_PUSH, RESTS = 5.0, 3.5, 1.0
"""Longest rollout, longest push in it, and least time after a push [s]."""


def _three(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
