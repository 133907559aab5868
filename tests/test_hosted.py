"""Meshes by services: the same faults against a server per service, and what is sent, kept and paid."""

from __future__ import annotations

import base64
import io
import json
import shutil
import ssl
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from email.utils import formatdate
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from PIL import Image

from f3sr.backends.protocols import ProducedMesh, PromptedImage
from f3sr.core.mesh import Mesh
from f3sr.errors import F3srError, InputError, NoAnswerError
from f3sr.generators.posed_assets import PosedAssets
from f3sr.hosted import job_files
from f3sr.hosted.cut_outs import cut_out_png, mask_png, photo_jpeg
from f3sr.hosted.hosted_client import HostedLimits
from f3sr.hosted.hosted_service import HostedService
from f3sr.hosted.limited_http import LostReplyError, NotSentError, exchange
from f3sr.hosted.mesh_producers import HostedProducer
from f3sr.hosted.service_key import ServiceKey, service_key
from f3sr.hosted.services import SERVICES
from f3sr.io.gltf_writer import mesh_to_glb
from f3sr.io.pose_conventions import SAM3D, all_conventions
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.scene import Geometry, Instance, Photo
from hosted_servers import API_ID, WIRES, Answer, LoopbackServer, Q, Wire, loopback_server, merged, sam3d_pose

KEY = "f3a1-4b2c-99:s3cr3t/0123+abcdef=Zq"
LIMITS = HostedLimits(
    deadline=4.0,
    request=2.0,
    download=2.0,
    first_wait=0.005,
    longest_wait=0.01,
    longest_retry_after=0.05,
    refusals=2,
    drops=2,
    json_bytes=100_000,
    mesh_bytes=200_000,
)
SERVICE = {service.name: service for service in SERVICES}
DIRECT = "hunyuan-server"


def box_glb(size: float = 1.0) -> bytes:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * size - size / 2
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return mesh_to_glb(Mesh(vertices=corners, faces=np.array(faces, np.int32)), name="box")


GLB = box_glb()


def glb_of(document: dict[str, Any], binary: bytes = b"") -> bytes:
    text = json.dumps({"asset": {"version": "2.0"}} | document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def triangle_glb(*, corners: int, count: int, uri: str | None = None) -> bytes:
    """A GLB that claims ``count`` vertices."""
    binary = bytes(12 * corners)
    buffer: dict[str, Any] = {"byteLength": len(binary)} | ({"uri": uri} if uri else {})
    return glb_of(
        {
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"componentType": 5126, "count": count, "type": "VEC3", "bufferView": 0}],
            "bufferViews": [{"buffer": 0, "byteLength": len(binary)}],
            "buffers": [buffer],
        },
        binary,
    )


@dataclass
class Bench:
    """The API, the host of files and one that must never be asked; the cache; the producer's limits."""

    api: LoopbackServer
    files: LoopbackServer
    evil: LoopbackServer
    cache: Path
    told: list[str] = field(default_factory=list)

    def service(self, wire: Wire) -> HostedService:
        return replace(SERVICE[wire.name], base_url=self.api.url, least_side=64)

    def producer(self, wire: Wire, **limits: Any) -> HostedProducer:
        return HostedProducer(
            service=self.service(wire),
            limits=replace(LIMITS, **limits),
            tell=self.told.append,
        )

    def serve(self, wire: Wire) -> None:
        """The service as it is when all goes well."""
        urls = [f"{self.files.url}/{k}.glb?sig=1" for k in range(wire.objects)]
        self.api.stage_of = wire.stage_of
        self.files.stage_of = lambda method, path: "download"
        done = merged(wire.state("done", None), {} if wire.separate else wire.result(urls))
        ticket = wire.ticket(API_ID, f"{self.api.url}{Q}/status", f"{self.api.url}{Q}")
        self.api.replies = {
            "submit": lambda n: _json(ticket),
            "upload": lambda n: _json({"code": 0, "data": {"image_token": "tok-1"}}),
            "poll": lambda n: _json(wire.state("waiting", None) if n == 0 else done),
            "result": lambda n: _json(wire.result(urls)),
        }
        self.files.replies = {"download": lambda n: ("model/gltf-binary", GLB)}
        if wire.name == DIRECT:
            self.api.replies = {"submit": lambda n: ("model/gltf-binary", GLB)}

    def run(self, wire: Wire, producer: HostedProducer | None = None, objects: int = 0) -> dict[int, ProducedMesh]:
        image = prompted(objects or wire.objects)
        return dict((producer or self.producer(wire)).produce(image, GEOMETRY, np.eye(3)))

    def records(self) -> list[dict[str, Any]]:
        return [json.loads(file.read_bytes()) for file in sorted(self.cache.rglob("job.json"))]


def _json(value: Any) -> tuple[str, bytes]:
    return "application/json", json.dumps(value).encode()


GEOMETRY = Geometry(points=np.zeros((2, 2, 3), np.float32), valid=np.zeros((2, 2), bool))


def prompted(objects: int, seed: int = 0) -> PromptedImage:
    rgb = np.random.default_rng(seed).integers(0, 255, (48, 64, 3), np.uint8)
    instances = list[Instance]()
    for k in range(objects):
        mask = np.zeros((48, 64), bool)
        mask[10 : 30 + k, 5 + 20 * k : 20 + 20 * k] = True
        instances.append(Instance(id=3 + 2 * k, label=f"thing {k}", name=f"{k}.png", mask=mask))
    return PromptedImage(photo=Photo(rgb=rgb), instances=tuple(instances))


@pytest.fixture(scope="module")
def servers() -> Iterator[tuple[LoopbackServer, ...]]:
    with ExitStack() as stack:
        yield tuple(stack.enter_context(loopback_server()) for _ in range(3))


@pytest.fixture
def bench(servers: tuple[LoopbackServer, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    for server in servers:
        server.reset()
    for service in SERVICES:
        if service.key_variable:
            monkeypatch.setenv(service.key_variable, KEY)
    cache = tmp_path / "cache"
    monkeypatch.setattr(job_files, "within", lambda name: cache / name)
    bench = Bench(*servers, cache)
    yield bench
    keep_the_laws(bench)


def keep_the_laws(bench: Bench) -> None:
    """After every test: where the key went, and what is on disk."""
    assert bench.evil.heard == []
    for heard in bench.files.heard:
        assert "authorization" not in heard.headers
        assert not leaks(f"{heard.path} {heard.headers}")
    for heard in bench.api.heard:
        assert not leaks(heard.path) and not leaks(heard.body.decode(errors="replace"))
    for file in bench.cache.rglob("*"):
        if file.is_file():
            assert file.name in ("job.json", "lock") or file.suffix == ".glb", f"half-written {file}"
            assert not leaks(file.read_bytes().decode(errors="replace"))
            if file.suffix == ".glb":
                assert file.read_bytes() == GLB
    assert not any(map(leaks, bench.told))


def leaks(text: str) -> bool:
    half = len(KEY) // 2
    parts = (KEY, KEY[:half], KEY[half:], KEY[:12], KEY[-12:], *KEY.split(":"))
    return any(form in text for part in parts for form in (part, quote(part, safe=""), quote(part, safe="").lower()))


# --- faults ---------------------------------------------------------------------------------------------------------

ECHO = json.dumps(
    {
        "detail": f"bad key {KEY} or {quote(KEY, safe='')}, begins {KEY[:17]}, ends {KEY[17:]} \u202e\x1b[2J",
        "error": KEY,
    }
).encode()
NEXT = "http://127.0.0.1:{evil}/next"


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What goes wrong, and how the run must end."""

    name: str
    stage: str
    """submit, poll or download; "ticket", "state" and "mesh" change the content of usual replies."""
    answer: Answer | None = None
    change: Callable[[Wire, Bench], Any] | None = None
    """Content of the changed reply."""
    fine: bool = False
    """Whether meshes come nonetheless."""
    posts: int = 1
    left: str = "accepted"
    """State of the job file of a service that is paid: "", "sent", "accepted" or "done"."""
    limits: dict[str, Any] = field(default_factory=dict)
    """Of HostedLimits; "direct" is the deadline of a direct service, whose one request may take as long."""
    says: str = ""
    """A part of the message."""


def submit(name: str, *, left: str, says: str = "", **answer: Any) -> Fault:
    return Fault(name=f"submit {name}", stage="submit", answer=Answer(**answer), left=left, says=says)


def poll(name: str, *, says: str = "", limits: dict[str, Any] | None = None, **answer: Any) -> Fault:
    return Fault(name=f"poll {name}", stage="poll", answer=Answer(**answer), says=says, limits=limits or {})


def download(name: str, *, says: str = "", limits: dict[str, Any] | None = None, **answer: Any) -> Fault:
    return Fault(name=f"download {name}", stage="download", answer=Answer(**answer), says=says, limits=limits or {})


def passes(fault: Fault, posts: int = 1) -> Fault:
    return replace(fault, fine=True, posts=posts, left="done")


DEEP = b"[" * 50_000 + b"]" * 50_000
HERE = "http://127.0.0.1:{api}"
FAULTS = [
    *(
        submit(f"{code} with the key echoed", status=code, body=ECHO, left="", says=str(code))
        for code in (400, 401, 402)
    ),
    *(
        submit(f"{code} with the key echoed", status=code, body=ECHO, left="", says=str(code))
        for code in (403, 404, 422)
    ),
    passes(submit("429 once", status=429, times=1, left=""), posts=2),
    passes(submit("429 with Retry-After 0", status=429, times=1, headers={"Retry-After": "0"}, left=""), posts=2),
    passes(submit("429 that asks for years", status=429, times=1, headers={"Retry-After": "9" * 30}, left=""), posts=2),
    passes(submit("429 with a bad date", status=429, times=1, headers={"Retry-After": "nan"}, left=""), posts=2),
    passes(submit("429 with a date", status=429, times=1, headers={"Retry-After": formatdate(0)}, left=""), posts=2),
    replace(submit("429 for ever", status=429, body=ECHO, left="", says="429"), posts=3),
    *(submit(f"{code}", status=code, body=ECHO, left="sent", says=str(code)) for code in (500, 502, 503, 504)),
    submit("503 with Retry-After", status=503, headers={"Retry-After": "0"}, left="sent", says="503"),
    replace(submit("timeout", delay=0.9, left="sent", says="within"), limits={"direct": 0.6, "request": 0.25}),
    submit("dropped", drop=True, left="sent", says="broke off"),
    replace(submit("drip", drip=0.02, left="sent", says="within"), limits={"direct": 0.6, "request": 0.25}),
    submit("redirect", status=302, headers={"Location": NEXT}, left="sent", says="redirect"),
    submit(
        "redirect 307 with the key", status=307, headers={"Location": f"{NEXT}?k={KEY}"}, left="sent", says="redirect"
    ),
    submit("announced too long", length=2_000_000_000, left="sent", says="accepted: at most"),
    submit("endless", endless=True, body=b"[", left="sent", says="more than"),
    submit("cut short", length=50_000, left="sent", says="broke off"),
    submit("compressed", headers={"Content-Encoding": "gzip"}, left="sent", says="compressed"),
    submit("deep JSON", body=DEEP[:99_000], left="sent"),
    submit("NaN", body=b'{"request_id": NaN, "id": NaN, "result": NaN, "code": NaN}', left="sent"),
    submit("a key twice", body=b'{"id": "a", "id": "b", "request_id": "a", "request_id": "b"}', left="sent"),
    submit("HTML", body=b"<!doctype html><p>hello", left="sent"),
    submit("no UTF-8", body=b'{"id": "\xff\xfe"}', left="sent"),
    submit("nothing", body=b"", left="sent"),
    submit("a list", body=b"[1, 2]", left="sent"),
    submit("no id", body=b"{}", left="sent"),
    *(
        Fault(name=f"id {name}", stage="ticket", change=lambda w, b, id=id: _ticket(w, b, id=id), left="sent")
        for name, id in (
            ("with path traversal", "../../v1/account"),
            ("with a slash", "a/b"),
            ("with a query", "a?b=c"),
            ("with a line break", "a\r\nX-Evil: 1"),
            ("that is the key", KEY),
            ("that is a number", 12),
            ("that is null", None),
        )
    ),
    *(
        Fault(name=f"state URL {name}", stage="ticket", change=lambda w, b, url=url: _ticket(w, b, poll=url), left=left)
        for name, url, left in (
            ("of another port", "http://127.0.0.1:{evil}/status", "accepted"),
            ("of another host", "http://localhost:{api}/status", "accepted"),
            ("of another scheme", "https://127.0.0.1:{api}/status", "accepted"),
            ("with a user", "http://127.0.0.1:{api}@127.0.0.1:{evil}/status", "accepted"),
            ("without a scheme", "//127.0.0.1:{evil}/status", "accepted"),
            ("of a file", "file:///etc/passwd", "accepted"),
            ("with the key", "http://127.0.0.1:{api}/?k=" + KEY, "sent"),
        )
    ),
    Fault(
        name="result URL of another host",
        stage="ticket",
        change=lambda w, b: _ticket(w, b, result="http://127.0.0.1:{evil}/result"),
    ),
    *(poll(f"{code} with the key echoed", status=code, body=ECHO, says=str(code)) for code in (401, 404, 410, 500)),
    *(passes(poll(f"{code} once", status=code, times=1)) for code in (429, 502, 503, 504)),
    passes(poll("503 with Retry-After", status=503, times=1, headers={"Retry-After": "1"})),
    poll("503 for ever", status=503, limits={"deadline": 0.3}, says="not done within"),
    passes(poll("dropped once", drop=True, times=1)),
    poll("dropped for ever", drop=True, says="broke off"),
    poll("timeout", delay=0.4, limits={"request": 0.15}, says="within"),
    poll("drip", drip=0.02, limits={"request": 0.15}, says="within"),
    poll("redirect", status=302, headers={"Location": f"{NEXT}?k={KEY}"}, says="redirect"),
    poll("too long", body=b" " * 100_001, says="accepted: at most"),
    poll("endless", endless=True, body=b"[", says="more than"),
    poll("compressed", headers={"Content-Encoding": "br"}, says="compressed"),
    poll("deep JSON", body=DEEP[:99_000], says="JSON"),
    poll("NaN", body=b'{"status": NaN}', says="JSON"),
    poll("HTML", body=b"<p>", says="JSON"),
    poll("no UTF-8", body=b'"\xff"', says="UTF-8"),
    poll("no state", body=b'{"code": 0}', says="documented"),
    poll("a list", body=b"[]", says="documented"),
    Fault(name="unknown state", stage="state", change=lambda w, b: w.state("THINKING", None), says="THINKING"),
    Fault(name="state that is the key", stage="state", change=lambda w, b: w.state(f"is {KEY}", None), says="[key]"),
    Fault(
        name="queue without end",
        stage="state",
        change=lambda w, b: w.state("waiting", None),
        limits={"deadline": 0.3},
        says="not done within",
    ),
    Fault(
        name="failed with the key and control characters",
        stage="state",
        change=lambda w, b: w.state("failed", f"no \x1b[31m{KEY}\r\n\x00 {quote(KEY)} in it"),
        left="",
        says="failed",
    ),
    *(
        Fault(name=f"mesh {name}", stage="mesh", change=lambda w, b, url=url: url, says=says)
        for name, url, says in (
            ("null", None, "documented"),
            ("without a URL", "", ""),
            ("of a file", "file:///etc/passwd.glb", "scheme"),
            ("of plain http elsewhere", "http://192.0.2.1/a.glb", "plain http"),
            ("as data URI", "data:model/gltf-binary;base64," + base64.b64encode(GLB).decode(), "scheme"),
            ("with the key in its URL", "http://127.0.0.1:{evil}/a.glb?k=" + quote(KEY, safe=""), "with the key"),
            ("with a user in its URL", "http://a:b@127.0.0.1:{evil}/a.glb", "with a user"),
            ("with a line break in its URL", "http://127.0.0.1:{evil}/a\r\nX: 1.glb", "characters"),
            ("with a number for a URL", 17, "documented"),
            ("of a bad port", "https://127.0.0.1:99999/a.glb", "no URL"),
        )
    ),
    *(download(f"{code}", status=code, body=ECHO, says=str(code)) for code in (403, 404, 500)),
    passes(download("503 once", status=503, times=1)),
    passes(download("dropped once", drop=True, times=1)),
    download("dropped for ever", drop=True, says="broke off"),
    download("redirect", status=302, headers={"Location": NEXT}, says="redirect"),
    download("of 2 GB as announced", length=2_000_000_000, says="accepted: at most"),
    download("of 2 GB without a length", endless=True, body=GLB, says="more than"),
    download("cut short", length=len(GLB) + 50, says="broke off"),
    download("cut short without a length", length=-1, body=GLB[:-20], says="claimed length"),
    download("timeout", delay=0.9, limits={"download": 0.06, "direct": 0.6}, says="within"),
    download("drip", drip=0.01, limits={"download": 0.06, "direct": 0.6}, says="within"),
    download("compressed", headers={"Content-Encoding": "gzip"}, says="compressed"),
    download("of another kind", body=b"<html>" + GLB, says="no GLB"),
    download("of nothing", body=b"", says="no GLB"),
    download("of zeros", body=b"glTF" + bytes(100), says="GLB version"),
    download("with another file's buffers", body=triangle_glb(corners=3, count=3, uri="/etc/passwd"), says="embedded"),
    download("with a host's buffers", body=triangle_glb(corners=3, count=3, uri="http://192.0.2.1/a"), says="embedded"),
    download("that claims a billion corners", body=triangle_glb(corners=3, count=3 * 10**9), says="accepted"),
    download("without faces", body=glb_of({"scenes": [{"nodes": []}]}), says="no faces"),
    download("of one point", body=triangle_glb(corners=3, count=3), says="accepted"),
]


def _ticket(wire: Wire, bench: Bench, **changed: Any) -> Any:
    usual = {"id": API_ID, "poll": f"{HERE}{Q}/status", "result": f"{HERE}{Q}"} | changed
    return wire.ticket(*(_placed(bench, value) for value in usual.values()))


def _placed(bench: Bench, text: Any) -> Any:
    ports = {"{api}": str(bench.api.port), "{evil}": str(bench.evil.port)}
    for name, port in ports.items():
        text = text.replace(name, port) if isinstance(text, str) else text
    return text


def inflict(fault: Fault, wire: Wire, bench: Bench) -> None:
    if fault.answer is not None:
        headers = {name: _placed(bench, value) for name, value in fault.answer.headers.items()}
        answer = replace(fault.answer, headers=headers)
        if fault.stage == "download" and wire.name != DIRECT:
            bench.files.faults["download"] = answer
        else:
            bench.api.faults["submit" if fault.stage == "download" else fault.stage] = answer
    if fault.change is None or wire.name == DIRECT:
        return
    made = _placed(bench, fault.change(wire, bench))
    if fault.stage == "ticket":
        bench.api.replies["submit"] = lambda n: _json(made)
    if fault.stage == "state":
        bench.api.replies["poll"] = lambda n: _json(made)
    if fault.stage == "mesh":
        result = wire.result([made] * wire.objects)
        done = merged(wire.state("done", None), {} if wire.separate else result)
        bench.api.replies |= {"poll": lambda n: _json(done), "result": lambda n: _json(result)}


def expected(fault: Fault, wire: Wire) -> Fault:
    """A direct service has no job: what concerns one does not happen, and a broken download is a lost reply."""
    limits = {name: value for name, value in fault.limits.items() if name != "direct"}
    if wire.name == DIRECT:
        limits = {"deadline": fault.limits["direct"]} if "direct" in fault.limits else {}
    fault = replace(fault, limits=limits)
    if wire.name != DIRECT:
        # A URL in the place of an id is refused with the ticket; fal's and Replicate's where it is used.
        no_urls = wire.name in ("meshy", "tripo") and "URL" in fault.name and fault.stage == "ticket"
        return replace(fault, left="sent") if no_urls else fault
    if fault.stage in ("poll", "ticket", "state", "mesh"):
        return replace(fault, fine=True, posts=1, left="done", says="")
    if fault.stage == "download":
        return replace(fault, fine=False, left="", says="" if fault.fine else fault.says)
    return replace(
        fault, left="done" if fault.fine else "", says="" if fault.answer and fault.answer.status == 200 else fault.says
    )


def inflicted() -> Iterator[Any]:
    """Faults in what a service says at every service. Those of HTTP, which one client hears for all, at every third
    service that has jobs, and at the one that has none; of those, what lasts until a limit at a third of all."""
    for k, name in enumerate(WIRES):
        for number, fault in enumerate(FAULTS):
            shared = fault.answer is not None and (name != DIRECT or bool(fault.limits))
            if not shared or (k + number) % 3 == 0:
                yield pytest.param(name, fault, id=f"{name}-{fault.name}")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fault"), list(inflicted()))
def test_a_fault_ends_in_meshes_or_in_one_line(name: str, fault: Fault, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    inflict(fault, wire, bench)
    wanted = expected(fault, wire)
    began = time.monotonic()
    if wanted.fine:
        made = bench.run(wire, bench.producer(wire, **wanted.limits))
        assert [len(m.mesh.faces) for m in made.values()] == [12] * wire.objects
    else:
        with pytest.raises(NoAnswerError) as raised:
            bench.run(wire, bench.producer(wire, **wanted.limits))
        said = str(raised.value)
        assert said.startswith(name) and said.isprintable() and "\n" not in said
        assert name == DIRECT or not leaks(said), said  # which has no key that a server could echo
        assert wanted.says in said
    assert time.monotonic() - began < LIMITS.deadline
    assert bench.api.count("submit") == wanted.posts
    assert [r["state"] for r in bench.records()] == ([wanted.left] if wanted.left else [])


def test_the_set_of_faults_is_large_and_named_once() -> None:
    assert len(FAULTS) >= 40 and len({fault.name for fault in FAULTS}) == len(FAULTS)


# --- what goes well -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WIRES)
def test_meshes_come_and_a_second_run_asks_nobody(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    made = bench.run(wire)
    assert list(made) == [3, 5][: wire.objects]
    for mesh in made.values():
        assert mesh.up == "+y" and len(mesh.mesh.faces) == 12
        assert name in mesh.told and SERVICE[name].licence in mesh.told
        assert (API_ID in mesh.told) == (name != DIRECT)
        assert (mesh.pose is not None) == (name == "fal-sam3d")
    heard = len(bench.api.heard) + len(bench.files.heard)
    again = bench.run(wire)
    assert len(bench.api.heard) + len(bench.files.heard) == heard
    for id, mesh in made.items():
        assert np.array_equal(again[id].mesh.vertices, mesh.mesh.vertices)
        assert again[id].pose == mesh.pose


@pytest.mark.parametrize("name", WIRES)
def test_only_requests_to_the_api_have_the_key(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    bench.run(wire)
    scheme = {"hunyuan-server": None}.get(name, f"{'Key' if name.startswith('fal') else 'Bearer'} {KEY}")
    assert {h.headers.get("authorization") for h in bench.api.heard} == {scheme}
    assert {h.headers.get("accept-encoding") for h in bench.api.heard + bench.files.heard} == {"identity"}
    assert not any(h.stage == "unknown" for h in bench.api.heard)


@pytest.mark.parametrize("name", [n for n in WIRES if n != DIRECT])
def test_a_run_that_is_killed_is_taken_up_without_paying_again(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    usual = bench.api.replies["poll"]

    def killed(n: int) -> tuple[str, bytes]:
        raise KeyboardInterrupt

    producer = bench.producer(wire)
    stopping = replace(producer, tell=lambda words: killed(0) if "accepted" in words else None)
    with pytest.raises(KeyboardInterrupt, match="the same command takes them up without paying again"):
        bench.run(wire, stopping)
    assert [r["state"] for r in bench.records()] == ["accepted"]
    bench.api.replies["poll"] = usual
    assert len(bench.run(wire, producer)) == wire.objects
    assert bench.api.count("submit") == 1


@pytest.mark.parametrize("name", [n for n in WIRES if n != DIRECT])
def test_a_request_without_an_answer_is_not_sent_again_by_a_later_run(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    bench.api.faults["submit"] = Answer(drop=True)
    with pytest.raises(NoAnswerError, match="may have been paid"):
        bench.run(wire)
    bench.api.faults.clear()
    with pytest.raises(NoAnswerError, match=r"may have been paid; look into your account, delete .*job.json"):
        bench.run(wire)
    assert bench.api.count("submit") == 1
    for file in bench.cache.rglob("job.json"):
        file.unlink()
    assert len(bench.run(wire)) == wire.objects
    assert bench.api.count("submit") == 2


@pytest.mark.parametrize("name", [n for n in WIRES if n not in (DIRECT, "fal-sam3d")])
def test_the_second_object_fails_and_the_first_is_kept(name: str, bench: Bench) -> None:
    """The job of the first is asked for no second time; that of the second was refused and is sent again."""
    wire = WIRES[name]
    bench.serve(wire)
    usual = bench.api.replies["submit"]
    bench.api.replies["submit"] = lambda n: usual(n) if n == 0 else ("application/json", b"")
    bench.api.faults = {}
    with pytest.raises(NoAnswerError):
        bench.run(wire, objects=2)
    assert sorted(r["state"] for r in bench.records()) == ["accepted", "sent"]
    for file in bench.cache.rglob("job.json"):
        if json.loads(file.read_bytes())["state"] == "sent":
            file.unlink()
    bench.api.replies["submit"] = usual
    assert list(bench.run(wire, objects=2)) == [3, 5]
    assert bench.api.count("submit") == 3


@pytest.mark.parametrize("name", WIRES)
def test_another_photo_mask_or_model_is_another_job(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    producer = bench.producer(wire)
    bench.run(wire, producer)
    producer.produce(prompted(wire.objects, seed=1), GEOMETRY, np.eye(3))
    other = replace(producer, service=replace(producer.service, model="other", least_side=300))
    other.produce(prompted(wire.objects), GEOMETRY, np.eye(3))
    assert bench.api.count("submit") == 3


@pytest.mark.parametrize("name", [n for n in WIRES if n != DIRECT])
def test_a_changed_mesh_file_is_downloaded_again(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    bench.run(wire)
    for file in bench.cache.rglob("*.glb"):
        file.write_bytes(b"glTF" + bytes(30))
    assert len(bench.run(wire)) == wire.objects
    assert bench.api.count("submit") == 1 and bench.files.count("download") == 2 * wire.objects


@pytest.mark.parametrize("name", [n for n in WIRES if n != DIRECT])
def test_a_job_file_that_cannot_be_read_stops_the_run(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    bench.run(wire)
    for file in bench.cache.rglob("job.json"):
        file.write_bytes(b"{")
    with pytest.raises(NoAnswerError, match="no job file of f3sr"):
        bench.run(wire)
    assert bench.api.count("submit") == 1


@pytest.mark.parametrize("name", WIRES)
def test_nothing_is_paid_where_nothing_can_be_kept(name: str, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    monkeypatch.setattr(job_files, "within", lambda name: None)
    if name == DIRECT:
        assert len(bench.run(wire)) == 1
    else:
        with pytest.raises(NoAnswerError, match="F3SR_CACHE_DIR"):
            bench.run(wire)
        assert bench.api.count("submit") == 0


@pytest.mark.parametrize("name", [n for n in WIRES if n != DIRECT])
def test_progress_tells_every_state_once(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    bench.run(wire)
    assert len(bench.told) == len(set(bench.told))
    said = " ".join(bench.told)
    assert "sending the request" in said and f"job {API_ID} is accepted" in said and "downloading mesh 1 of" in said


@pytest.mark.parametrize("name", [n for n in WIRES if n != DIRECT])
def test_the_job_file_is_on_disk_before_the_request_and_has_the_id_before_the_first_poll(
    name: str, bench: Bench
) -> None:
    """A process may be killed at any moment, also without a chance to say or write anything."""
    wire = WIRES[name]
    bench.serve(wire)
    seen = list[tuple[str, str]]()

    def watched(stage: str) -> Callable[[int], tuple[str, bytes]]:
        usual = bench.api.replies[stage]

        def reply(n: int) -> tuple[str, bytes]:
            seen.extend((record["state"], record["id"]) for record in bench.records())
            return usual(n)

        return reply

    bench.api.replies |= {stage: watched(stage) for stage in ("submit", "poll")}
    bench.run(wire)
    assert seen[:2] == [("sent", ""), ("accepted", API_ID)]


def test_a_server_that_is_not_there_costs_nothing(bench: Bench) -> None:
    wire = WIRES["meshy"]
    bench.serve(wire)
    producer = bench.producer(wire)
    producer = replace(producer, service=replace(producer.service, base_url="http://127.0.0.1:9"))
    with pytest.raises(NoAnswerError, match="no connection"):
        bench.run(wire, producer)
    assert bench.records() == []


# --- SAM 3D ---------------------------------------------------------------------------------------------------------

SAM3D_FAULTS = {
    "fewer meshes than masks": lambda r: r["individual_glbs"].pop(),
    "more meshes than masks": lambda r: r["individual_glbs"].append(r["individual_glbs"][0]),
    "no list of meshes": lambda r: r.update(individual_glbs=None),
    "fewer poses than masks": lambda r: r["metadata"].pop(),
    "an index twice": lambda r: r["metadata"][0].update(object_index=0),
    "an index beyond": lambda r: r["metadata"][0].update(object_index=9),
    "an index that is text": lambda r: r["metadata"][0].update(object_index="1"),
    "an index that is a truth value": lambda r: r["metadata"][0].update(object_index=True),
    "poses that are no objects": lambda r: r.update(metadata=[1, 2]),
    "NaN in a pose": lambda r: r["metadata"][0].update(translation=[[float("nan"), 0, 1]]),
    "infinity in a pose": lambda r: r["metadata"][0].update(translation=[["1e999", 0, 1]]),
    "scale zero": lambda r: r["metadata"][0].update(scale=[[0, 0, 0]]),
    "negative scale": lambda r: r["metadata"][0].update(scale=[[-1, -1, -1]]),
    "three scales": lambda r: r["metadata"][0].update(scale=[[1, 2, 3]]),
    "a quaternion of length 2": lambda r: r["metadata"][0].update(rotation=[[2, 0, 0, 0]]),
    "a quaternion of length 0": lambda r: r["metadata"][0].update(rotation=[[0, 0, 0, 0]]),
    "half a quaternion": lambda r: r["metadata"][0].update(rotation=[[1, 0]]),
    "half a pose": lambda r: r["metadata"][0].update(rotation=None),
    "text in a pose": lambda r: r["metadata"][0].update(translation=["a", "b", "c"]),
}


def sam3d_result(bench: Bench) -> dict[str, Any]:
    return WIRES["fal-sam3d"].result([f"{bench.files.url}/{k}.glb" for k in range(2)])


@pytest.mark.parametrize("name", SAM3D_FAULTS)
def test_a_result_of_sam_3d_that_does_not_fit_the_masks_is_refused(name: str, bench: Bench) -> None:
    wire = WIRES["fal-sam3d"]
    bench.serve(wire)
    result = sam3d_result(bench)
    SAM3D_FAULTS[name](result)
    bench.api.replies["result"] = lambda n: (
        "application/json",
        json.dumps(result).replace('"1e999"', "1e999").encode(),
    )
    with pytest.raises(NoAnswerError) as raised:
        bench.run(wire)
    assert str(raised.value).startswith("fal-sam3d, job") and str(raised.value).isprintable()
    assert bench.api.count("submit") == 1
    assert [r["state"] for r in bench.records()] == ["accepted"]


def test_a_result_of_422_is_a_failed_job(bench: Bench) -> None:
    wire = WIRES["fal-sam3d"]
    bench.serve(wire)
    bench.api.faults["result"] = Answer(status=422, body=ECHO)
    with pytest.raises(NoAnswerError, match="the job failed"):
        bench.run(wire)
    assert bench.records() == []


@pytest.mark.parametrize("poses", ["null", "nulls", "none"])
def test_meshes_of_sam_3d_without_poses_are_taken(poses: str, bench: Bench) -> None:
    wire = WIRES["fal-sam3d"]
    bench.serve(wire)
    result = sam3d_result(bench)
    if poses == "none":
        del result["metadata"]
    elif poses == "null":
        result["metadata"] = None
    else:
        result["metadata"] = [sam3d_pose(k, rotation=None, translation=None, scale=None) for k in range(2)]
    bench.api.replies["result"] = lambda n: _json(result)
    assert [mesh.pose for mesh in bench.run(wire).values()] == [None, None]


def test_one_mask_takes_the_one_mesh(bench: Bench) -> None:
    wire = WIRES["fal-sam3d"]
    bench.serve(wire)
    result = {"model_glb": {"url": f"{bench.files.url}/0.glb"}, "individual_glbs": None, "metadata": [sam3d_pose(0)]}
    bench.api.replies["result"] = lambda n: _json(result)
    assert list(bench.run(wire, objects=1)) == [3]


def test_poses_follow_their_index_and_the_convention_of_sam_3d(bench: Bench) -> None:
    """A vertex of the GLB by the formulas of the model's row vectors, and both orders of the quaternion."""
    wire = WIRES["fal-sam3d"]
    bench.serve(wire)
    made = bench.run(wire)
    vertex = np.array([0.1, 0.2, 0.3])
    local = np.array([0.1, -0.3, 0.2])  # the export wrote (x, z, -y)
    turns = {
        "wxyz": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], float),  # 90 degrees about y
        "xyzw": np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]], float),  # (x, z) = half: 180 about x + z
    }
    for k, mesh in enumerate(made.values()):
        assert mesh.pose is not None
        places = CandidatePlaces.of_poses({k: mesh.pose}, all_conventions())
        assert places.names[0] == SAM3D.name, "the documented one comes first"
        for order, R in turns.items():
            reading = places.names.index(replace(SAM3D, order=order).name)
            in_camera = (0.3 * local) @ R + [0.1 * k, 0.2, 1.5]
            found = places.scale[reading, 0] * places.R[reading, 0] @ vertex + places.t[reading, 0]
            assert np.allclose(found, in_camera * [-1, -1, 1])
            assert np.linalg.det(places.R[reading, 0]) == pytest.approx(1)


def test_sam_3d_gets_the_photo_and_a_mask_per_object(bench: Bench) -> None:
    wire = WIRES["fal-sam3d"]
    bench.serve(wire)
    bench.run(wire)
    sent = next(h for h in bench.api.heard if h.stage == "submit")
    assert sent.path == "/fal-ai/sam-3/3d-objects"
    photo, *masks = (decoded(uri) for uri in (sent.json["image_url"], *sent.json["mask_urls"]))
    assert photo.size == (64, 48) and photo.format == "JPEG"
    for mask, instance in zip(masks, prompted(2).instances, strict=True):
        assert np.array_equal(np.asarray(mask) == 255, instance.mask)


def decoded(uri: str) -> Image.Image:
    image = Image.open(io.BytesIO(base64.b64decode(uri.partition("base64,")[2])))
    image.load()
    return image


# --- what is sent ---------------------------------------------------------------------------------------------------

SENT = {
    "fal-trellis2": ("/fal-ai/trellis-2", lambda body: body["image_url"]),
    "fal-hunyuan": ("/fal-ai/hunyuan-3d/v3.1/pro/image-to-3d", lambda body: body["input_image_url"]),
    "replicate": ("/v1/predictions", lambda body: body["input"]["image"]),
    "meshy": ("/openapi/v1/image-to-3d", lambda body: body["image_url"]),
    "hunyuan-server": ("/generate", lambda body: "base64," + body["image"]),
}


@pytest.mark.parametrize("name", SENT)
def test_services_of_one_object_get_its_cut_out_and_no_neighbour(name: str, bench: Bench) -> None:
    wire = WIRES[name]
    bench.serve(wire)
    bench.run(wire)
    path, picture = SENT[name]
    sent = next(h for h in bench.api.heard if h.stage == "submit")
    assert sent.path == path
    cut_out = np.asarray(decoded(picture(sent.json)))
    assert cut_out.shape == (64, 64, 4)
    assert set(np.unique(cut_out[0, :, 3])) == {0} and cut_out[..., 3].max() == 255
    assert not cut_out[cut_out[..., 3] == 0].any()


def test_tripo_gets_the_picture_first_and_then_its_token(bench: Bench) -> None:
    wire = WIRES["tripo"]
    bench.serve(wire)
    bench.run(wire)
    upload, task = (h for h in bench.api.heard if h.method == "POST")
    assert upload.stage == "upload" and upload.headers["content-type"].startswith("multipart/form-data; boundary=")
    start = upload.body.index(b"\x89PNG")
    assert Image.open(io.BytesIO(upload.body[start:])).mode == "RGBA"
    assert task.json["file"] == {"type": "png", "file_token": "tok-1"} and task.json["orientation"] == "align_image"


def test_an_upload_that_fails_leaves_no_job(bench: Bench) -> None:
    wire = WIRES["tripo"]
    bench.serve(wire)
    for answer in (Answer(drop=True), Answer(status=500), Answer(body=b'{"code": 2002, "message": "no"}')):
        bench.api.faults["upload"] = answer
        with pytest.raises(NoAnswerError):
            bench.run(wire)
        assert bench.api.count("submit") == 0 and bench.records() == []


@pytest.mark.parametrize(
    ("output", "fine"),
    [
        ("{files}/0.glb", True),
        (["{files}/0.glb"], True),
        ({"mesh": "{files}/0.glb?x=y.png", "video": "{files}/v.mp4"}, True),
        ({"files": [{"glb": "{files}/0.glb"}]}, True),
        ("{files}/model", True),
        (["{files}/a.glb", "{files}/b.glb"], False),
        ({"video": "{files}/v.mp4", "splat": "{files}/s.ply"}, False),
        (None, False),
        ([], False),
        (5, False),
    ],
)
def test_outputs_of_replicate_have_many_forms(output: Any, fine: bool, bench: Bench) -> None:
    wire = WIRES["replicate"]
    bench.serve(wire)
    placed = json.loads(json.dumps(output).replace("{files}", bench.files.url))
    bench.api.replies["poll"] = lambda n: _json({"status": "succeeded", "output": placed})
    if fine:
        assert len(bench.run(wire)) == 1
    else:
        with pytest.raises(NoAnswerError, match="GLB files among"):
            bench.run(wire)


@pytest.mark.parametrize(
    ("model", "version", "input"),
    [("a/b", "a/b", "image"), ("a/b:0f3a", "a/b:0f3a", "image"), ("0f3a@input_image", "0f3a", "input_image")],
)
def test_models_of_replicate_are_named_with_version_and_field(
    model: str, version: str, input: str, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = WIRES["replicate"]
    bench.serve(wire)
    made = producer_of(f"replicate:{model}")
    producer = replace(made, service=replace(made.service, base_url=bench.api.url), limits=LIMITS)
    bench.run(wire, producer)
    body = bench.api.heard[0].json
    assert body["version"] == version and list(body["input"]) == [input]


def producer_of(spec: str) -> HostedProducer:
    """The producer that a user asks for."""
    made = ASSET_GENERATORS.find(spec).made
    assert isinstance(made, PosedAssets) and isinstance(made.producer, HostedProducer)
    return made.producer


# --- keys, addresses, names -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WIRES)
def test_every_service_is_found_by_its_name(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    variable = SERVICE[name].key_variable
    monkeypatch.setenv(variable or "UNUSED", KEY)
    backend = ASSET_GENERATORS.find(name)
    assert not leaks(backend.told + backend.key + repr(backend.made)) and SERVICE[name].licence in backend.told
    (need,) = (found.needs for found in ASSET_GENERATORS.examined() if found.name == name)
    assert need[0].met == bool(variable) and not leaks(repr(need))
    if variable:
        monkeypatch.delenv(variable)
        (need,) = (found.needs for found in ASSET_GENERATORS.examined() if found.name == name)
        assert not need[0].met and variable in need[0].remedy


@pytest.mark.parametrize(
    "model", ["../x", "a b", "a/../b", "https://evil/x", "a?b", "-x", "a:b", "a@b", "//evil", "a" * 300, "x\n"]
)
def test_a_model_that_cannot_be_one_is_refused(model: str) -> None:
    with pytest.raises(InputError, match="model of fal-trellis2"):
        ASSET_GENERATORS.find(f"fal-trellis2:{model}")


@pytest.mark.parametrize(
    "address", ["10.0.0.1:8080", "ftp://a", "http://a:b@c", "http://a?x=1", "http://", "http://a b", "http://a:99999"]
)
def test_an_address_that_cannot_be_one_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="address of hunyuan-server"):
        ASSET_GENERATORS.find(f"hunyuan-server:{address}")


def test_the_users_server_is_asked_where_the_user_says(bench: Bench) -> None:
    wire = WIRES[DIRECT]
    bench.serve(wire)
    made = producer_of(f"hunyuan-server:{bench.api.url}/")
    assert len(made.produce(prompted(2), GEOMETRY, np.eye(3))) == 2
    assert bench.api.count("submit") == 2


def test_without_an_address_or_a_key_nothing_is_sent(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="address of hunyuan-server"):
        producer_of(DIRECT).produce(prompted(1), GEOMETRY, np.eye(3))
    for value in ("", "short", "with space and more", "kéyкéyкéy"):
        monkeypatch.setenv("FAL_KEY", value)
        with pytest.raises(InputError, match="FAL_KEY") as raised:
            bench.run(WIRES["fal-trellis2"])
        assert not value or value not in str(raised.value)
    assert bench.api.heard == []


def test_no_key_goes_over_plain_http_to_another_machine(bench: Bench) -> None:
    wire = WIRES["meshy"]
    producer = bench.producer(wire)
    producer = replace(producer, service=replace(producer.service, base_url="http://192.0.2.1"))
    with pytest.raises(InputError, match="a key only over https"):
        bench.run(wire, producer)


def test_a_service_elsewhere_cannot_point_to_this_machine(bench: Bench) -> None:
    from f3sr.hosted.hosted_client import HostedClient

    service = SERVICE["meshy"]
    client = HostedClient(service=service, key=ServiceKey(KEY), limits=LIMITS, end=time.monotonic() + 1)
    for url in (f"{bench.evil.url}/a.glb", "https://localhost/a.glb"):
        with pytest.raises(F3srError, match="this machine"):
            client.download(url)


def test_a_photo_without_objects_asks_for_nothing(bench: Bench) -> None:
    producer = bench.producer(WIRES["meshy"])
    image = replace(prompted(1), instances=())
    assert dict(producer.produce(image, GEOMETRY, np.eye(3))) == {}
    assert bench.api.heard == []


def test_a_key_is_cut_out_in_every_form(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAL_KEY", f" {KEY}\n")
    key = service_key("FAL_KEY")
    half = len(KEY) // 2
    for form in (
        KEY,
        KEY.upper(),
        quote(KEY),
        quote(KEY, safe=""),
        quote(KEY, safe="").lower(),
        KEY[:half],
        KEY[half:],
    ):
        assert key.redacted(f"a {form} b") == "a [key] b"
        assert key.is_in(form)
    assert key.redacted(f"a {KEY[5:22]} b") == "a [key] b"
    assert key.redacted(f"{KEY}{KEY} {KEY[3:]}") == "[key] [key]"
    assert key.redacted("plain words") == "plain words" and KEY not in repr(key)
    assert ServiceKey().redacted(KEY) == KEY


# --- TLS ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A certificate of this machine that nobody has signed, and its key, in one file."""
    folder = tmp_path_factory.mktemp("tls")
    openssl = shutil.which("openssl")
    if not openssl:
        pytest.skip("no openssl")
    key, chain = folder / "key.pem", folder / "chain.pem"
    made = [openssl, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made += ["-keyout", str(key), "-out", str(chain), "-days", "2", "-subj", "/CN=localhost"]
    made += ["-addext", "subjectAltName=DNS:localhost"]
    subprocess.run(made, check=True, capture_output=True)
    both = folder / "both.pem"
    both.write_bytes(key.read_bytes() + chain.read_bytes())
    return both


@pytest.fixture
def tls(certificate: Path) -> Iterator[LoopbackServer]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    with loopback_server(context) as server:
        server.replies = {"any": lambda n: ("text/plain", b"hello")}
        yield server


def asked(url: str, seconds: float = 2.0) -> bytes:
    return exchange("GET", url, headers={}, body=None, seconds=seconds, most=1000).body


def test_a_certificate_that_nobody_signed_gets_no_request(tls: LoopbackServer) -> None:
    with pytest.raises(NotSentError, match="certificate"):
        asked(f"https://localhost:{tls.port}/")
    assert tls.heard == []


def test_replies_by_tls_have_the_same_limits(
    tls: LoopbackServer, certificate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = ssl.create_default_context(cafile=str(certificate))
    monkeypatch.setattr(ssl, "create_default_context", lambda: context)
    assert asked(f"https://localhost:{tls.port}/") == b"hello"
    with pytest.raises(NotSentError):  # a certificate of another name
        asked(f"https://127.0.0.1:{tls.port}/")
    began = time.monotonic()
    for fault in (Answer(drip=0.05), Answer(delay=0.4)):
        tls.faults["any"] = fault
        with pytest.raises(LostReplyError, match=r"within 0\.1 s"):
            asked(f"https://localhost:{tls.port}/", seconds=0.1)
    assert time.monotonic() - began < 1
    tls.faults["any"] = Answer(drop=True)
    with pytest.raises(LostReplyError, match="broke off"):
        asked(f"https://localhost:{tls.port}/")
    tls.faults["any"] = Answer(length=9)
    with pytest.raises(LostReplyError, match="broke off"):
        asked(f"https://localhost:{tls.port}/")


# --- pictures -------------------------------------------------------------------------------------------------------


def test_a_cut_out_is_square_with_a_margin_and_small_enough() -> None:
    rgb = np.random.default_rng(0).integers(1, 255, (300, 400, 3), np.uint8)
    mask = np.zeros((300, 400), bool)
    mask[0:200, 300:400] = True  # at the photo's border: the square reaches beyond it
    mask[50:100, 320:360] = False  # what is seen through it is another object's
    image = Image.open(io.BytesIO(cut_out_png(rgb, mask, least=64, longest=2000, most_bytes=10**7)))
    assert image.size == (250, 250)
    alpha = np.asarray(image)[..., 3]
    assert np.array_equal(np.flatnonzero(alpha.any(1))[[0, -1]], [25, 224])
    assert np.array_equal(np.flatnonzero(alpha.any(0))[[0, -1]], [75, 174])
    shown = np.where(mask[..., None], rgb, 0)
    assert np.array_equal(np.asarray(image)[25:225, 75:175, :3], shown[0:200, 300:400])
    small = cut_out_png(rgb, mask, least=64, longest=2000, most_bytes=20_000)
    assert len(small) <= 20_000
    assert Image.open(io.BytesIO(cut_out_png(rgb, mask, least=512, longest=600, most_bytes=10**7))).size == (512, 512)
    assert Image.open(io.BytesIO(cut_out_png(rgb, mask, least=10, longest=100, most_bytes=10**7))).size == (100, 100)
    assert Image.open(io.BytesIO(cut_out_png(rgb, mask, least=10, longest=400, most_bytes=10))).size == (64, 64)


def test_photo_and_masks_shrink_together() -> None:
    rgb = np.zeros((600, 900, 3), np.uint8)
    jpeg, size = photo_jpeg(rgb, longest=300)
    assert size == (300, 200) and Image.open(io.BytesIO(jpeg)).size == size
    mask = np.zeros((600, 900), bool)
    mask[:300, :450] = True
    image = np.asarray(Image.open(io.BytesIO(mask_png(mask, size))))
    assert image.shape == (200, 300) and set(np.unique(image)) == {0, 255} and image[:100, :150].all()
    assert (image > 0).mean() == 0.25
