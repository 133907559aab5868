"""Hosted services by name, their meshes posed in the photo (docs: hosted)."""

from __future__ import annotations

from f3sr.generators.posed_assets import PosedMaker
from f3sr.hosted import mesh_producers

fal_sam3d = PosedMaker(mesh_producers.fal_sam3d)
fal_trellis2 = PosedMaker(mesh_producers.fal_trellis2)
fal_hunyuan = PosedMaker(mesh_producers.fal_hunyuan)
replicate = PosedMaker(mesh_producers.replicate)
meshy = PosedMaker(mesh_producers.meshy)
tripo = PosedMaker(mesh_producers.tripo)
hunyuan_server = PosedMaker(mesh_producers.hunyuan_server)
