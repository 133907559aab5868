"""Finished parts as arrays, and the key under which they are kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from f3sr.core.mesh import ConvexPart, MassProperties
from f3sr.core.transforms import Array
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.fit import Excess
from f3sr.proxies.joins import Join
from f3sr.proxies.parts import FittedParts
from f3sr.proxies.surface import Faces
from f3sr.runtime.result_store import Arrays

PROXY_VERSION = 7
"""Part of the cache key; raise it when the same input and config give other parts."""


def key_of(vertices: Array, faces: Faces, config: ProxyConfig) -> str:
    """A hash of a normalised mesh and of all that its parts depend on."""
    digest = hashlib.sha256(f"{PROXY_VERSION} {config_json(config)} {vertices.shape} {faces.shape}".encode())
    digest.update(vertices.tobytes())
    digest.update(faces.tobytes())
    return digest.hexdigest()


def config_json(config: ProxyConfig) -> str:
    return json.dumps(asdict(config), sort_keys=True)


def packed(fitted: FittedParts) -> Arrays:
    """As arrays that ``unpacked`` reads: vertices, faces, counts (parts, 2), the fit, the solid, and the joins."""
    inflation, floor = (np.nan if x is None else x for x in (fitted.inflation, fitted.excess.floor))
    excess = fitted.excess
    return {
        "vertices": np.concatenate([p.vertices for p in fitted.parts]),
        "faces": np.concatenate([p.faces for p in fitted.parts]),
        "counts": np.array([(len(p.vertices), len(p.faces)) for p in fitted.parts], np.int32),
        "fit": np.array([inflation, fitted.outside, excess.mean, excess.most, excess.largest, floor, *excess.at]),
        "solid": np.array([fitted.solid.volume, *fitted.solid.center, *fitted.solid.inertia.ravel()]),
        "joins": np.array([(j.first, j.second, j.loss) for j in fitted.joins], np.float64).reshape(-1, 3),
    }


def unpacked(data: Mapping[str, Any]) -> FittedParts:
    cuts = np.cumsum(data["counts"], axis=0)[:-1]
    vertices, faces = np.split(data["vertices"], cuts[:, 0]), np.split(data["faces"], cuts[:, 1])
    inflation, outside, mean, most, largest, floor, x, y, z = map(float, data["fit"])
    volume, *moments = data["solid"].tolist()
    return FittedParts(
        parts=tuple(ConvexPart(vertices=v.copy(), faces=f.copy()) for v, f in zip(vertices, faces, strict=True)),
        inflation=None if np.isnan(inflation) else inflation,
        outside=outside,
        excess=Excess(mean=mean, most=most, largest=largest, floor=None if np.isnan(floor) else floor, at=(x, y, z)),
        solid=MassProperties(volume=volume, center=np.array(moments[:3]), inertia=np.array(moments[3:]).reshape(3, 3)),
        joins=tuple(Join(first=int(a), second=int(b), loss=float(loss)) for a, b, loss in data["joins"]),
    )
