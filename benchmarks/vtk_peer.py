"""VTK drawing the same textured meshes off screen: the peer of ``rendering.py``."""

from __future__ import annotations

import numpy as np
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 - registers the renderer
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPolyData
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkPolyDataMapper,
    vtkRenderer,
    vtkRenderWindow,
    vtkTexture,
    vtkWindowToImageFilter,
)

from f3sr.core.transforms import Array
from f3sr.scene import Scene, SceneObject


class Renderer:
    """One window, kept from frame to frame; the picture is read back as numpy, as ours is."""

    def __init__(self, scene: Scene) -> None:
        self._window, self._renderer = vtkRenderWindow(), vtkRenderer()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(4)
        self._window.SetSize(scene.camera.width, scene.camera.height)
        self._window.AddRenderer(self._renderer)
        self._actors = [_actor(o) for o in scene.objects]
        for actor in self._actors:
            self._renderer.AddActor(actor)
        camera, T, K = self._renderer.GetActiveCamera(), scene.camera.T_world_camera, scene.camera.K
        camera.SetPosition(*T[:3, 3])
        camera.SetFocalPoint(*(T[:3, 3] + T[:3, 2]))
        camera.SetViewUp(*-T[:3, 1])
        camera.SetViewAngle(float(np.degrees(2 * np.arctan(scene.camera.height / 2 / K[1, 1]))))
        self._renderer.ResetCameraClippingRange()

    def frame(self, poses: Array) -> NDArray[np.uint8]:
        for actor, T in zip(self._actors, poses, strict=True):
            matrix = vtkMatrix4x4()
            matrix.DeepCopy(T.ravel().tolist())
            actor.SetUserMatrix(matrix)
        self._window.Render()
        grab = vtkWindowToImageFilter()
        grab.SetInput(self._window)
        grab.ReadFrontBufferOff()
        grab.Update()
        image = grab.GetOutput()
        width, height, _ = image.GetDimensions()
        return vtk_to_numpy(image.GetPointData().GetScalars()).reshape(height, width, -1)[::-1]


def _actor(o: SceneObject) -> vtkActor:
    data, points, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    points.SetData(numpy_to_vtk(o.scale * o.mesh.vertices, deep=True))
    faces = np.column_stack([np.full(len(o.mesh.faces), 3), o.mesh.faces]).astype(np.int64)
    cells.SetCells(len(faces), numpy_to_vtkIdTypeArray(faces.ravel(), deep=True))
    data.SetPoints(points)
    data.SetPolys(cells)
    actor, mapper, texture = vtkActor(), vtkPolyDataMapper(), o.mesh.materials[0].texture
    if o.mesh.uv is not None and texture is not None:
        data.GetPointData().SetTCoords(numpy_to_vtk(o.mesh.uv, deep=True))
        image, shown = vtkImageData(), vtkTexture()
        image.SetDimensions(texture.shape[1], texture.shape[0], 1)
        image.GetPointData().SetScalars(numpy_to_vtk(texture[::-1].reshape(-1, 3).copy(), deep=True))
        shown.SetInputData(image)
        shown.InterpolateOn()
        shown.MipmapOn()
        actor.SetTexture(shown)
    mapper.SetInputData(data)
    actor.SetMapper(mapper)
    actor.GetProperty().LightingOff()
    return actor
