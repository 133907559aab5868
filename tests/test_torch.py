"""The silhouette integrals in torch against the compiled kernels, and the choice of where they are computed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import trimesh

from f3sr import devices, doctor, inputs
from f3sr.contour import AREA, Integrals
from f3sr.devices import DeviceError, Opened, open_torch, results_of
from f3sr.errors import InputError
from f3sr.frames import Array, Camera, pose, rotation_from_vector
from f3sr.freedom import ObjectFreedom
from f3sr.mesh_io import load_mesh
from f3sr.report import Decision
from f3sr.scene import Scene
from f3sr.silhouette import Surface, Target
from f3sr.silhouette_fit import FitSearch, ObjectFit, one_by_one
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.assemble import assemble
from f3sr.stages.level import level
from folders import write_folder

needs_torch = pytest.mark.skipif(find_spec("torch") is None, reason='without torch: pip install "f3sr[torch]"')

FORWARD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
Question = tuple[ObjectFit, Array]


def fit_of(mesh: tuple[Array, Array], *, size: tuple[int, int], away: float, seed: int = 0, aside: float = 0.0):
    """A mesh against its own mask, moved, a part of it hidden, seen from ``away`` [m] in an image of some size."""
    rng = np.random.default_rng(seed)
    width, height = size
    K = np.array([[1.1 * width, 2.0, 0.5 * width], [0, 1.2 * width, 0.48 * height], [0, 0, 1]])
    camera = Camera(width=width, height=height, K=K, T_world_camera=pose(FORWARD, [0.03 + aside, -away, 0.02]))
    surface = Surface.of([(np.asarray(mesh[0], float), np.asarray(mesh[1], np.int32))])
    freedom = ObjectFreedom(anchor=surface.vertices.mean(0), basis=FORWARD[:, :2], reach=np.full(6, 0.3))
    T, s = freedom.similarity(rng.uniform(-0.2, 0.2, 6))
    mask = surface.moved(T, s).silhouette(camera)
    valid = np.ones_like(mask)
    valid[: height // 3, : width // 2] = False
    return ObjectFit(
        surface=surface, camera=camera, target=Target.of(mask, valid), freedom=freedom, prior=np.zeros(6)
    )  # fmt: skip


def turned(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    return np.asarray(mesh.vertices) @ rotation_from_vector([0.5, 0.3, 0.2]).T, np.asarray(mesh.faces)


def soup(count: int, seed: int) -> tuple[Array, Array]:
    """Triangles that share nothing, some without area."""
    corners = np.random.default_rng(seed).uniform(-0.4, 0.4, (3 * count, 3))
    corners[3:6] = corners[3]
    return corners, np.arange(3 * count).reshape(-1, 3)


def shell() -> tuple[Array, Array]:
    """Half a ball, open."""
    ball = trimesh.creation.icosphere(3, 0.3)
    return np.asarray(ball.vertices), np.asarray(ball.faces)[ball.triangles_center[:, 2] > 0.05]


def made() -> dict[str, Question]:
    ring, box = turned(trimesh.creation.torus(0.3, 0.1)), turned(trimesh.creation.box((0.5, 0.3, 0.4)))
    ball = turned(trimesh.creation.icosphere(5, 0.3))
    u = np.array([0.2, -0.1, 0.3, 0.1, -0.2, 0.15])
    return {
        "ring": (fit_of(ring, size=(160, 120), away=1.5), u),
        "the same fit elsewhere": (fit_of(ring, size=(97, 211), away=1.2), -u),
        "box": (fit_of(box, size=(333, 200), away=1.5), u),
        "soup": (fit_of(soup(60, 1), size=(128, 128), away=1.5), u),
        "shell": (fit_of(shell(), size=(101, 90), away=1.4), u),
        "triangles below a pixel": (fit_of(ball, size=(64, 64), away=2.0), u),
        "cut by the border": (fit_of(ring, size=(150, 150), away=1.1, aside=0.4), u),
        **{f"cut by the near plane {k}": (fit_of(soup(8, k), size=(140, 100), away=0.05), u) for k in (1, 2, 8)},
        "around the camera": (fit_of(box, size=(80, 60), away=0.01), 0 * u),
        "outside the image": (fit_of(box, size=(90, 70), away=1.5, aside=9.0), u),
        "behind the camera": (fit_of(ring, size=(90, 70), away=-2.0), u),
    }


def assert_close(a: Sequence[Integrals], b: Sequence[Integrals], tolerance: float, names: Sequence[str]) -> None:
    assert len(a) == len(b) == len(names)
    for name, p, q in zip(names, a, b, strict=True):
        for part in ("value", "gradient", "curvature"):
            x, y = getattr(p, part), getattr(q, part)
            assert np.abs(x - y).max() <= tolerance * np.abs(x).max(), (name, part)


# --- the same mathematics -----------------------------------------------------------------------------------------


@needs_torch
def test_torch_agrees_with_the_kernels_on_all_kinds_of_meshes_at_once():
    questions = made()
    expected = one_by_one(list(questions.values()))
    assert_close(expected, open_torch("torch-cpu").answers(list(questions.values())), 1e-4, list(questions))
    empty = {name for name, found in zip(questions, expected, strict=True) if not found.value[AREA]}
    flat = {name for name, found in zip(questions, expected, strict=True) if not found.gradient.any()}
    assert empty == {"outside the image", "behind the camera"} and flat == empty | {"around the camera"}


def masks_agree(fits: Sequence[ObjectFit]) -> list[bool]:
    """Whether a fit's hard mask is that of the kernels."""
    from f3sr.torch_twin.batch import Batch, Stock
    from f3sr.torch_twin.mask import hard_mask, projected

    batch = Batch.of(Stock.empty("cpu").with_fits(fits), [(fit, np.zeros(6)) for fit in fits])
    found = hard_mask(projected(batch), batch).numpy()
    expected = [fit.silhouette(np.zeros(6)) for fit in fits]
    return [
        np.array_equal(m[: e.shape[0], : e.shape[1]], e) and np.count_nonzero(m) == np.count_nonzero(e)
        for m, e in zip(found, expected, strict=True)
    ]


@needs_torch
def test_hard_masks_are_equal_at_the_near_plane():
    """Triangles of decimetres, and of millimetres, which is how far it is."""
    large = [fit_of(soup(3, k), size=(60, 40 + k % 7), away=0.03) for k in range(40)]
    small = [
        fit_of((0.01 * v + [0.03, 0, 0.02], f), size=(60, 45), away=0.001) for v, f in (soup(3, k) for k in range(40))
    ]
    assert all(masks_agree(large + small))


@needs_torch
def test_hard_masks_are_equal_where_triangles_meet_at_pixel_centres():
    """Fans around a pixel's centre: only the bound of the rounding keeps it covered."""
    fits = [fan(k) for k in range(200)]
    assert all(masks_agree(fits)) and all(fit.silhouette(np.zeros(6))[8, 8] for fit in fits)


def fan(seed: int) -> ObjectFit:
    """Triangles around the point behind the middle of pixel (8, 8)."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 3)) / 3 + np.arange(3) * 2 * np.pi / 3
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)]) * rng.uniform(0.01, 0.5, (3, 1))
    depth = rng.uniform(0.5, 3, 4)
    aside, focal = rng.uniform(-0.3, 0.3, 2), np.array([13.0, 11.0])
    K = np.column_stack([np.diag([*focal, 0.0])[:, :2], [*(8.5 - focal * aside), 1]])
    rays = np.vstack([np.zeros(3), rim]) + np.array([*aside, 1.0])
    surface = Surface.of([(rays * depth[:, None], np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]], np.int32))])
    camera = Camera(width=17, height=17, K=K, T_world_camera=pose())
    freedom = ObjectFreedom(anchor=np.zeros(3), basis=np.eye(3)[:, :2], reach=np.ones(6))
    target = Target.of(surface.silhouette(camera))
    return ObjectFit(surface=surface, camera=camera, target=target, freedom=freedom, prior=np.zeros(6))


@needs_torch
def test_torch_agrees_with_the_kernels_on_real_meshes(shared_data: Path):
    names, questions = list[str](), list[Question]()
    for k, file in enumerate(sorted((shared_data / "objects").glob("*.glb"))[::4]):
        mesh = load_mesh(file)
        unit = 0.6 / np.ptp(mesh.vertices, axis=0).max()
        fit = fit_of((unit * mesh.vertices, mesh.faces), size=(200 + 20 * k, 300 - 20 * k), away=1.3, seed=k)
        names += 2 * [file.stem]
        questions += [(fit, u) for u in np.random.default_rng(k).uniform(-0.5, 0.5, (2, 6))]
    assert len(questions) >= 8
    assert_close(one_by_one(questions), open_torch("torch-cpu").answers(questions), 1e-4, names)


@needs_torch
def test_the_batch_changes_nothing(monkeypatch: pytest.MonkeyPatch):
    """Not its order, nor what else is in it, nor where it is split; and a second time gives the same bytes."""
    from f3sr.torch_twin import integrals

    questions = made()
    names, asked = list(questions), list(questions.values())
    answers = open_torch("torch-cpu").answers
    together = answers(asked)
    assert_close(together, answers(asked[::-1])[::-1], 1e-12, names)
    assert_close(together, [answers([question])[0] for question in asked], 1e-12, names)
    for a, b in zip(together, answers(asked), strict=True):
        assert a.value.tobytes() == b.value.tobytes() and a.gradient.tobytes() == b.gradient.tobytes()
        assert a.curvature.tobytes() == b.curvature.tobytes()
    monkeypatch.setattr(integrals, "LARGEST_BATCH", 3000)
    assert_close(together, answers(asked), 1e-12, names)


@needs_torch
def test_no_tensor_is_left_to_the_default_device():
    """On a GPU a tensor made without naming the device would lie on the CPU; here it would lie on none, and raise."""
    import torch

    questions = list(made().values())
    with torch.device("meta"):
        found = open_torch("torch-cpu").answers(questions)
    assert_close(one_by_one(questions), found, 1e-4, list(made()))


@needs_torch
def test_a_surface_goes_to_the_device_once():
    from f3sr.torch_twin.integrals import TorchIntegrals

    (ring, u), (box, _), *_ = made().values()
    answers = TorchIntegrals("cpu")
    answers([(ring, u), (ring, -u)])
    first = answers._stock
    answers([(ring, 0 * u)])
    assert answers._stock is first and len(first.vertices.rows) == len(ring.surface.vertices)
    answers([(box, u), (ring, u)])
    assert len(answers._stock.vertices.rows) == len(ring.surface.vertices) + len(box.surface.vertices)


@needs_torch
def test_align_ends_in_the_same_poses(wrong: Scene):
    cpu, _ = align(wrong, AlignConfig(device="cpu", camera=False))
    twin, report = align(wrong, AlignConfig(device="torch-cpu", camera=False))
    assert any(np.abs(o.T_world_object - wrong[o.id].T_world_object).max() > 1e-3 for o in cpu)
    for o in cpu:
        assert np.allclose(o.T_world_object, twin[o.id].T_world_object, atol=1e-6)
        assert o.scale == pytest.approx(twin[o.id].scale, rel=1e-6)
    assert any("torch" in d.choice for d in report.decisions) and not report.fallbacks


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Three boxes off by 6%, levelled."""
    folder = tmp_path_factory.mktemp("wrong") / "input"
    write_folder(folder, perturb=0.06, seed=3)
    return level(assemble(inputs.read(folder))[0])[0]


# --- where they are computed --------------------------------------------------------------------------------------


def searches(count: int = 3) -> list[FitSearch[Array]]:
    """Of boxes, from one seed each."""
    box = turned(trimesh.creation.box((0.5, 0.3, 0.4)))
    fits = [fit_of(box, size=(60, 50 + k), away=1.5, seed=k) for k in range(count)]

    def end(fit: ObjectFit) -> FitSearch[Array]:
        return (yield from fit.best((0.1,), kept=1, iterations=4)).x

    return [end(fit) for fit in fits]


def gpu(monkeypatch: pytest.MonkeyPatch, answers: Callable[[Sequence[Question]], Sequence[Integrals]] | None) -> None:
    """A machine whose GPU gives these answers, or cannot be opened."""

    def opened(device: str) -> Opened:
        if answers is None:
            raise DeviceError("RuntimeError: CUDA driver too old")
        return Opened(name="a GPU", answers=answers)

    monkeypatch.setattr(devices, "why_no_cuda", lambda: None)
    monkeypatch.setattr(devices, "open_torch", opened)


@pytest.fixture(scope="module")
def expected() -> list[Array]:
    return results_of(searches(), "cpu")[0]


def test_auto_takes_a_gpu_that_works_and_asks_it_everything_at_once(
    monkeypatch: pytest.MonkeyPatch, expected: list[Array]
):
    asked: list[int] = []

    def answers(questions: Sequence[Question]) -> list[Integrals]:
        asked.append(len(questions))
        return one_by_one(questions)

    gpu(monkeypatch, answers)
    found, told = results_of(searches(), "auto")
    assert np.array_equal(found, expected)
    assert asked[:3] == [3, 3, 6] and len(asked) < sum(asked) / 2
    assert told == [Decision(choice="objects: silhouettes computed on a GPU", reason='device = "auto"')]


def test_auto_without_a_gpu_is_the_cpu_and_no_news(monkeypatch: pytest.MonkeyPatch, expected: list[Array]):
    monkeypatch.setattr(devices, "why_no_cuda", lambda: "no driver")
    found, told = results_of(searches(), "auto")
    assert np.array_equal(found, expected) and not told


def test_auto_says_that_a_gpu_does_not_work(monkeypatch: pytest.MonkeyPatch, expected: list[Array]):
    gpu(monkeypatch, None)
    found, (told,) = results_of(searches(), "auto")
    assert np.array_equal(found, expected) and told.fallback and "CUDA driver too old" in told.reason


def test_auto_goes_on_where_a_gpu_stops(monkeypatch: pytest.MonkeyPatch, expected: list[Array]):
    gpu(monkeypatch, failing_after(4))
    found, told = results_of(searches(), "auto")
    assert np.array_equal(found, expected)
    assert [d.fallback for d in told] == [False, True] and "out of memory" in told[1].reason


def failing_after(rounds: int) -> Callable[[Sequence[Question]], Sequence[Integrals]]:
    done: list[None] = []

    def answers(questions: Sequence[Question]) -> list[Integrals]:
        done.append(None)
        if len(done) > rounds:
            raise RuntimeError("CUDA out of memory\nand a page of advice")
        return one_by_one(questions)

    return answers


@pytest.mark.parametrize("answers", [None, failing_after(2)])
def test_a_gpu_that_was_asked_for_and_fails_is_one_clear_error(
    monkeypatch: pytest.MonkeyPatch, answers: Callable[..., Sequence[Integrals]] | None
):
    gpu(monkeypatch, answers)
    with pytest.raises(InputError, match=r'^align.device: found "cuda", but .*; accepted: "auto", "cpu"') as error:
        results_of(searches(), "cuda")
    assert "\\n" not in str(error.value) and "advice" not in str(error.value)


@pytest.mark.parametrize("device", ["cuda", "torch-cpu"])
def test_without_torch_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, device: devices.TorchDevice):
    monkeypatch.setattr(devices, "_torch_version", lambda: None)
    with pytest.raises(InputError, match=r"torch is not installed: pip install"):
        results_of(searches(1), device)


def test_what_keeps_torch_from_a_gpu_is_found_without_importing_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setattr(devices, "CUDA_DRIVER", "libno-such-driver.so.1")
    monkeypatch.setattr(devices, "_torch_version", lambda: "2.13.0+cpu")
    assert "built without CUDA" in str(devices.why_no_cuda())
    monkeypatch.setattr(devices, "_torch_version", lambda: "2.13.0+cu130")
    assert "libno-such-driver" in str(devices.why_no_cuda())
    monkeypatch.setattr(devices, "_has_driver", lambda: True)
    assert devices.why_no_cuda() is None
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert "CUDA_VISIBLE_DEVICES" in str(devices.why_no_cuda())


def test_a_machine_without_a_driver_never_imports_torch():
    code = """
import sys
from f3sr import devices
from f3sr.stages import align
devices.CUDA_DRIVER = "libno-such-driver.so.1"
devices.results_of([], "auto")
assert "torch" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@needs_torch
def test_a_device_that_computes_wrongly_is_not_opened(monkeypatch: pytest.MonkeyPatch):
    from f3sr.torch_twin.integrals import TorchIntegrals

    def doubled(self: TorchIntegrals, questions: Sequence[Question]) -> list[Integrals]:
        return [Integrals(value=2 * f.value, gradient=f.gradient, curvature=f.curvature) for f in one_by_one(questions)]

    monkeypatch.setattr(TorchIntegrals, "__call__", doubled)
    with pytest.raises(DeviceError, match="wrong values"):
        open_torch("torch-cpu")


def test_the_doctor_knows_the_devices(monkeypatch: pytest.MonkeyPatch):
    gpu(monkeypatch, None)
    check = doctor._torch("cuda")
    assert check.state == "missing" and check.found == "RuntimeError: CUDA driver too old"
    gpu(monkeypatch, one_by_one)
    check = doctor._torch("cuda")
    assert check.state == "ok" and check.found.startswith("a GPU")


def test_a_device_that_cannot_work_is_refused_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "_torch_version", lambda: None)
    with pytest.raises(InputError, match=r"refine\.align\.device.*torch is not installed"):
        devices.require("torch-cpu", "refine.align.device")
    for device in ("auto", "cpu"):
        devices.require(device, "align.device")
