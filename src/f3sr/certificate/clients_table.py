"""The engines and validators of a certificate: what each is given, what brings it, and what it cannot do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

SCRIPTS = Path(__file__).parent / "clients"
Given = Literal["scene.xml", "scene.glb", "urdf", "sdf", "usd", "usd props", "mjcf"]
"""Files of the package, and of the formats of ``f3sr export``."""


@dataclass(frozen=True, kw_only=True)
class Client:
    """Another program that a package is handed to."""

    name: str
    title: str
    script: str
    """In ``clients/``: its environment runs it."""
    given: Given
    install: str
    """The command that brings it."""
    cannot: str = ""
    """Of an engine: what of the package it does not read or do."""

    @property
    def format(self) -> str:
        """The format of ``f3sr export`` that it is given, or the package's own file."""
        return self.given.partition(" ")[0]

    @property
    def path(self) -> Path:
        return SCRIPTS / self.script

    @property
    def runs_in_node(self) -> bool:
        """Whether ``node`` runs its script, not Python."""
        return self.script.endswith(".cjs")


def _table(*clients: Client) -> Mapping[str, Client]:
    return MappingProxyType({client.name: client for client in clients})


ENGINES = _table(
    Client(
        name="mujoco",
        title="MuJoCo",
        script="release_mujoco.py",
        given="scene.xml",
        install="pip install mujoco",
        cannot="restitution",
    ),
    Client(
        name="mujoco-warp",
        title="MuJoCo Warp",
        script="release_mujoco_warp.py",
        given="scene.xml",
        install="pip install mujoco-warp",
        cannot="restitution; needs room for contacts stated before it starts; compiles for minutes the first time",
    ),
    Client(
        name="mjx",
        title="MJX",
        script="release_mjx.py",
        given="scene.xml",
        install="pip install mujoco-mjx",
        cannot="restitution; keeps room for contacts of every pair of hulls, so that scenes with many do not compile",
    ),
    Client(
        name="newton",
        title="Newton",
        script="release_newton.py",
        given="scene.xml",
        install="pip install 'newton[sim]' pillow trimesh",
        cannot="restitution and the photo's camera; tells no penetration",
    ),
    Client(
        name="pybullet",
        title="PyBullet",
        script="release_pybullet.py",
        given="urdf",
        install="pip install pybullet",
        cannot="the larger friction of a pair: it takes the product, which URDF's square roots allow for",
    ),
    Client(
        name="drake",
        title="Drake",
        script="release_drake.py",
        given="sdf",
        install="pip install drake",
        cannot="rolling and spinning friction, restitution: what is round rolls; tells no penetration of areas",
    ),
    Client(
        name="sapien",
        title="SAPIEN",
        script="release_sapien.py",
        given="urdf",
        install="pip install sapien==3.0.3",
        cannot="rolling and spinning friction, friction in files; misses now and then where small parts touch",
    ),
)
"""By name. MuJoCo is always there: f3sr needs it."""

VALIDATORS = _table(
    Client(
        name="simready",
        title="NVIDIA simready-validate, Robotics-Prop 4.0.0",
        script="validate_simready.py",
        given="usd props",
        install="pip install simready-validate simready-foundation-tier-core",
    ),
    Client(
        name="usd",
        title="OpenUSD validators",
        script="validate_usd.py",
        given="usd",
        install="pip install usd-core",
    ),
    Client(
        name="mjcf-doctor",
        title="mjcf-doctor",
        script="validate_mjcf.py",
        given="mjcf",
        install="pip install mjcf-doctor mujoco",
    ),
    Client(
        name="gltf",
        title="Khronos glTF validator",
        script="validate_gltf.cjs",
        given="scene.glb",
        install="npm install gltf-validator, and NODE_PATH to its node_modules",
    ),
)
CLIENTS: Mapping[str, Client] = MappingProxyType({**ENGINES, **VALIDATORS})
