"""Laws of the peers' proxies: they lie in the mesh's frame, and one hull is taken where the product takes one."""

from __future__ import annotations

import numpy as np
import pytest

import peers
from f3sr.core.mesh import Mesh, union
from f3sr.proxies import ProxyConfig
from f3sr.proxies.config import CutConfig
from scenes import box, box_mesh, scene_of

QUICK = ProxyConfig(cuts=CutConfig(target_faces=600, samples=2000))


def l_shape() -> Mesh:
    """An L of 1 by 1 m, away from the origin."""
    foot, leg = box_mesh((1.0, 0.5, 0.3)).hull, box_mesh((0.3, 0.5, 1.0)).hull
    T = np.eye(4)
    T[:3, 3] = [-0.35, 0, 0.35]
    vertices, faces = union([foot, leg.moved(T)])
    return Mesh(vertices=vertices + np.array([3.0, 0, 0]), faces=faces)


@pytest.mark.parametrize(("method", "package"), [("coacd", "coacd"), ("vhacd", "vhacdx")])
def test_a_peer_finds_several_parts_where_the_mesh_is(method: str, package: str) -> None:
    pytest.importorskip(package)
    mesh = l_shape()
    proxy = peers.decompose(mesh, method, QUICK)
    assert proxy.method == method and len(proxy.parts) >= 2
    corners = np.concatenate([p.vertices for p in proxy.parts])
    assert np.allclose([corners.min(0), corners.max(0)], mesh.bounds, atol=0.02)


def test_a_box_is_one_hull_whatever_the_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "PEERS", {})
    proxy = peers.decompose(box_mesh((0.3, 0.2, 0.1)), "coacd", QUICK)
    assert proxy.method == "hull" and len(proxy.parts) == 1


def test_a_peer_that_finds_no_volume_leaves_one_hull_in_the_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "PEERS", {"none": lambda *_: [np.zeros((4, 3))]})
    assert peers.decompose(l_shape(), "none", QUICK).method == "hull-fallback"
    scene, outcome = peers.stage("none")(scene_of(box(1), box(2)), QUICK)
    assert [len(o.parts) for o in scene] == [1, 1]
    assert [id for id, fit in outcome.fits.items() if fit.inflation is not None] == [1, 2]
