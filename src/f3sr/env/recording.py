"""Episodes of an environment as a LeRobot dataset, for training policies: a wrapper that writes what it sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from f3sr.env.controllers import POSE, VELOCITIES
from f3sr.env.lerobot_dataset import Feature, LeRobotDataset
from f3sr.env.scene_env import RATE, Observation, SceneEnv
from f3sr.errors import InputError
from f3sr.exporters.export_names import export_name
from f3sr.film.video import even
from f3sr.physics.mujoco_scene import MujocoScene
from f3sr.scene import Scene

STATE, OBJECTS, ACTION = "observation.state", "observation.environment_state", "action"
PICTURE = "observation.images.photo"
REWARD, DONE, SUCCESS = "next.reward", "next.done", "next.success"


class Recording(gymnasium.Wrapper[Observation, NDArray[Any], Observation, NDArray[Any]]):
    """An environment whose episodes go to a LeRobot dataset in ``out``.

    A frame has what was seen before an action, the action, and the reward after it: the controller's state, poses and
    velocities of all objects (13 numbers each, in the order of ids), and the picture of pictured observations or of
    ``render_mode="rgb_array"``. Numbers are single precision, as LeRobot's. An episode is written when it ends, at the
    next reset, and at ``close``; its last frame is done. ``task``, the goal unless given, may differ between episodes.

    Raises InputError for another environment or without a task, OutputError where ``out`` may not be written.
    """

    def __init__(
        self, env: gymnasium.Env[Observation, NDArray[Any]], out: str | Path, *, task: str = "", append: bool = False
    ) -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, SceneEnv):
            raise InputError("env", found=type(inner).__name__, accepted="an environment of f3sr")
        self.scene_env = inner
        self.task = task or inner.goal
        if not self.task:
            raise InputError("task", found="none, and no goal", accepted="a goal of the environment, or words")
        self._seen: dict[str, NDArray[Any]] | None = None
        robot = "two_finger_gripper" if inner.controller.state_names else "pushed_object"
        self.dataset = LeRobotDataset(out, features_of(inner), fps=RATE, robot=robot, append=append)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Write what was recorded, and begin an episode."""
        self.save()
        observation, info = super().reset(seed=seed, options=options)
        self._seen = self._sight(observation)
        return observation, info

    def step(self, action: NDArray[Any]) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Act, and record it. Raises ``gymnasium.error.ResetNeeded`` after the end of an episode."""
        seen = self._seen
        if seen is None:
            raise gymnasium.error.ResetNeeded("the episode has ended: reset() begins the next one")
        observation, reward, terminated, truncated, info = super().step(action)
        after: dict[str, Any] = {REWARD: [reward], SUCCESS: [info["success"]], DONE: [terminated or truncated]}
        self.dataset.add({**seen, ACTION: action, **after}, task=self.task)
        self._seen = self._sight(observation)
        if terminated or truncated:
            self.save()
        return observation, reward, terminated, truncated, info

    def save(self) -> None:
        """End the episode here and write it; without a step since the last one nothing is written."""
        self._seen = None
        self.dataset.save(last={DONE: [True]})

    def discard(self) -> None:
        """End the episode here and forget it."""
        self._seen = None
        self.dataset.discard()

    def close(self) -> None:
        """Write the episode that goes on, and end the dataset."""
        try:
            self.save()
        finally:
            self.dataset.close()
            super().close()

    def _sight(self, observation: Observation) -> dict[str, NDArray[Any]]:
        inner = self.scene_env
        found = {OBJECTS: _numbers(inner.playable)}
        if inner.controller.state_names:
            found[STATE] = inner.controller.state
        if inner.pictures_wanted:
            found[PICTURE] = even(observation["picture"] if "picture" in observation else inner.picture())
        return found


def features_of(env: SceneEnv) -> dict[str, Feature]:
    """What every frame of an environment's episodes holds."""
    control = env.controller
    numbers = {STATE: control.state_names, OBJECTS: _names(env.package.scene), ACTION: control.action_names}
    found = {k: Feature(dtype="float32", shape=(len(n),), names=n) for k, n in numbers.items() if n}
    found |= {name: Feature(dtype="bool", shape=(1,)) for name in (DONE, SUCCESS)}
    found[REWARD] = Feature(dtype="float32", shape=(1,))
    if env.pictures_wanted:
        height, width = (n + n % 2 for n in env.picture_size)
        found[PICTURE] = Feature(dtype="video", shape=(height, width, 3), names=("height", "width", "channels"))
    return found


def _names(scene: Scene) -> tuple[str, ...]:
    return tuple(f"{export_name(o.id, o.label)}.{n}" for o in scene for n in (*POSE, *VELOCITIES))


def _numbers(playable: MujocoScene) -> NDArray[Any]:
    """(13 N,): pose and velocity of every object."""
    return np.concatenate([playable.states(), playable.velocities()], axis=1).ravel()
