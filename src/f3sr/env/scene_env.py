"""A scene package as a Gymnasium environment: actions move a gripper or an object, a goal in words gives the reward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.env.controllers import Controller, GripperControl, ObjectControl
from f3sr.env.environment_arguments import (
    Control,
    Observed,
    Reward,
    require_action,
    require_arguments,
    require_scene,
)
from f3sr.env.episode_pictures import EpisodePictures
from f3sr.env.goal_progress import GoalProgress, task_of
from f3sr.env.gripper import GripperConfig
from f3sr.env.resets import Randomization, ResetDraw, bank_of, draw
from f3sr.errors import require_path
from f3sr.files.bounds import FARTHEST
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, build_spec, engine
from f3sr.physics.mujoco_scene import MujocoScene
from f3sr.scene import Scene
from f3sr.scene_package.package import Package, read_package

SAMPLE = 5
"""Steps of physics between two samples of a goal's rollout: 10 ms."""
RATE = 20
"""Actions in a second."""
SAMPLES = round(1 / (RATE * SAMPLE * DEFAULT_PHYSICS.timestep))
"""Samples of every action."""

Observation = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class StagedScene:
    """One scene of the bank, compiled once; ``mass``, ``inertia`` and ``friction`` as the package has them."""

    scene: Scene
    playable: MujocoScene
    controller: Controller
    mass: Array
    inertia: Array
    friction: Array

    def start(self, drawn: ResetDraw) -> None:
        """At rest as the scene is, with the materials that were drawn."""
        mujoco, model, data = engine(), self.playable.model, self.playable.data
        n = len(self.playable.ids)
        bodies = slice(1, n + 1)
        factors = np.array(drawn.mass)
        model.body_mass[bodies] = self.mass[bodies] * factors
        model.body_inertia[bodies] = self.inertia[bodies] * factors[:, None]
        # Geoms of the world are the ground's, whose factor is the last; those of a gripper keep theirs.
        rubs = np.array([drawn.friction[-1], *drawn.friction[:-1]])
        owner = np.asarray(model.geom_bodyid)
        own = owner <= n
        model.geom_friction[own] = self.friction[own] * rubs[owner[own], None]
        mujoco.mj_resetData(model, data)
        mujoco.mj_setConst(model, data)
        self.controller.reset()
        mujoco.mj_forward(model, data)


class SceneEnv(gymnasium.Env[Observation, NDArray[Any]], EzPickle):
    """Objects of a package at rest, a gripper above them, and a goal.

    ``observation``: "state" gives ``poses`` (N, 7), position [m] and quaternion (w, x, y, z), ``velocities`` (N, 6)
    [m/s, rad/s], as ``MujocoScene`` has them, and ``controller``. "pictures" gives ``picture`` (h, w, 3) instead,
    "both" gives all. ``control`` is "velocity", in [-1, 1] of the limits, or "pose", in metres and quaternions. Without
    ``gripper``, actions are velocities of the goal's object. ``reward`` is 1 where the goal is met ("success"), or
    grows with the least margin of its conditions ("margin"). An episode ends there, and is truncated after ``seconds``.

    Equal seeds give equal episodes, to the bit. A copy, or what was pickled, is made anew from the package's folder and
    begins with a reset. Raises InputError for a bad package or argument.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": RATE}  # noqa: RUF012 - Gymnasium's own

    def __init__(
        self,
        package: str | Path | Package,
        goal: str = "",
        *,
        gripper: bool | GripperConfig = True,
        control: Control = "velocity",
        observation: Observed = "state",
        reward: Reward = "success",
        seconds: float = 10.0,
        samples: str | Path | None = None,
        randomization: Randomization | None = None,
        longest: int = 320,
        render_mode: str | None = None,
    ) -> None:
        require_arguments(
            goal=goal,
            gripper=gripper,
            control=control,
            observation=observation,
            reward=reward,
            seconds=seconds,
            randomization=randomization,
            longest=longest,
            render_mode=render_mode,
        )
        self.package = package if isinstance(package, Package) else read_package(require_path("package", package))
        self.render_mode, self.goal = render_mode, goal
        self.task = task_of(self.package.scene, goal) if goal else None
        self._conditions = self.task.conditions if self.task else ()
        self._randomization = randomization or Randomization()
        self._reward, self._observed = reward, observation
        self._steps = max(1, round(seconds * RATE))
        config = gripper if isinstance(gripper, GripperConfig) else GripperConfig() if gripper else None
        active = self.task.active if self.task else None
        self._stages = [_staged(scene, config, control, active) for scene in bank_of(self.package, samples)]
        self._stage = self._stages[0]
        self._pictures = EpisodePictures(self.package, longest, config)
        self.action_space: spaces.Space[Any] = self._stage.controller.space
        self.observation_space: spaces.Space[Any] = spaces.Dict(self._spaces())
        self._taken, self._ended = 0, True  # no episode goes on before the first reset
        self._progress = self._progress_of(self._stage)
        self._potential = 0.0
        EzPickle.__init__(
            self,
            self.package.folder.absolute(),
            goal,
            gripper=gripper,
            control=control,
            observation=observation,
            reward=reward,
            seconds=seconds,
            samples=samples,
            randomization=randomization,
            longest=longest,
            render_mode=render_mode,
        )

    @property
    def scene(self) -> Scene:
        """The scene of this episode, as it was at its start."""
        return self._stage.scene

    @property
    def playable(self) -> MujocoScene:
        """MuJoCo's model and data of this episode."""
        return self._stage.playable

    @property
    def controller(self) -> Controller:
        """What actions move."""
        return self._stage.controller

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw a scene of the bank and materials. ``options`` may name the ``scene``, an index of the bank."""
        super().reset(seed=seed)
        drawn = draw(self.np_random, len(self._stages), len(self.package.scene.objects), self._randomization)
        index = require_scene(options, drawn.scene, len(self._stages))
        self._stage, self._taken, self._ended = self._stages[index], 0, False
        self._stage.start(drawn)
        if self.pictures_wanted:
            self._pictures.vary(self.np_random, self._randomization)
        self._progress = self._progress_of(self._stage)
        self._progress.add(self.playable.data, self.playable.states())
        self._potential = self._margin()
        return self._observation(), {"scene": index, "goal": self.goal}

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act for 50 ms. Raises InputError for an action of another shape or that is not finite, and Gymnasium's
        ResetNeeded before the first reset and after the end of an episode."""
        commanded = require_action(action, self.action_space.shape)
        if self._ended:
            raise ResetNeeded("no episode goes on: reset() begins the next one")
        mujoco, play, controller = engine(), self.playable, self.controller
        model, data = play.model, play.data
        dt = SAMPLE * model.opt.timestep
        controller.command(commanded)
        for _ in range(SAMPLES):
            controller.act(dt)
            mujoco.mj_step(model, data, SAMPLE)
            self._progress.add(data, play.states())
        self._taken += 1
        met = self._progress.met()
        reward = float(met)
        if self._reward == "margin":
            before, self._potential = self._potential, self._margin()
            reward += self._potential - before
        lost = not (np.abs(data.qpos) < FARTHEST).all() or not (np.abs(data.qvel) < FARTHEST).all()
        terminated, truncated = met or lost, self._taken >= self._steps
        self._ended = terminated or truncated
        info = {"success": met, "time": float(data.time)}
        return self._observation(), reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The photo's view now (h, w, 3), the gripper included."""
        return self.picture() if self.render_mode == "rgb_array" else None

    def judged(self) -> Sequence[Any]:
        """Every condition of the goal as it stands (``goals.conditions.Judged``), in words too."""
        return self._progress.judged()

    @property
    def pictures_wanted(self) -> bool:
        """Whether episodes have pictures, observed or rendered."""
        return self._observed != "state" or self.render_mode is not None

    def picture(self) -> NDArray[np.uint8]:
        """The photo's view now (h, w, 3), the gripper included; (h, w) is ``picture_size``."""
        return self._pictures.drawn(self.playable.poses(), self.controller.poses())

    @property
    def picture_size(self) -> tuple[int, int]:
        """Height and width of pictures [px]."""
        return self._pictures.size

    def _margin(self) -> float:
        """Least relative margin of what is not met, from -1 to 0; 0 where all is met."""
        if self._reward != "margin" or not self._conditions:
            return 0.0
        return min(0.0, max(-1.0, min(j.relative if not j.met else 0.0 for j in self._progress.judged())))

    def _progress_of(self, stage: StagedScene) -> GoalProgress:
        most, model = SAMPLES * self._steps, stage.playable.model
        return GoalProgress(scene=stage.scene, conditions=self._conditions, samples=most, model=model)

    def _spaces(self) -> dict[str, spaces.Space[Any]]:
        n = len(self.package.scene.objects)
        found: dict[str, spaces.Space[Any]] = {}
        if self._observed != "pictures":
            found["poses"] = spaces.Box(-FARTHEST, FARTHEST, (n, 7), np.float64)
            found["velocities"] = spaces.Box(-FARTHEST, FARTHEST, (n, 6), np.float64)
            found["controller"] = spaces.Box(-FARTHEST, FARTHEST, self.controller.state.shape, np.float64)
        if self._observed != "state":
            height, width = self.picture_size
            found["picture"] = spaces.Box(0, 255, (height, width, 3), np.uint8)
        return found

    def _observation(self) -> Observation:
        found: Observation = {}
        if self._observed != "pictures":
            found["poses"] = self.playable.states()
            found["velocities"] = self.playable.velocities()
            found["controller"] = self.controller.state
        if self._observed != "state":
            found["picture"] = self.picture()
        return found


def _staged(scene: Scene, config: GripperConfig | None, control: str, active: int | None) -> StagedScene:
    """A scene with what acts in it, compiled."""
    spec = build_spec(scene.objects, ground_friction=scene.ground.friction)
    if config is not None:
        GripperControl.hang(spec, scene, config)
    playable = MujocoScene.compiled(spec, scene.objects)
    model = playable.model
    controller: Controller
    if config is not None:
        controller = GripperControl.of(playable, scene, config, poses=control == "pose")
    else:
        controller = ObjectControl.of(playable, scene, active)
    copies = (np.array(a) for a in (model.body_mass, model.body_inertia, model.geom_friction))
    return StagedScene(scene, playable, controller, *copies)
