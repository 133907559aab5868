"""The services that are known, each from its own documentation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from f3sr.hosted.hosted_service import (
    VERSIONED_MODEL,
    HostedRequest,
    HostedService,
    JobFailedError,
    JobState,
    JobTicket,
    MeshReply,
    UnexpectedReplyError,
    job_id,
    job_state,
    text_at,
    value_at,
)

SEED = 1
"""Of every job whose service takes one."""
MAX_LEAVES = 200
"""Most texts of a Replicate output that are looked at."""
HUNYUAN_LICENCE = "Tencent Hunyuan 3D licence: not for use in the EU, the UK and South Korea"

# --- fal (source: fal.ai documentation, "Queue" and the models' API pages) ---------------------------------------


def _fal_ticket(reply: Any) -> JobTicket:
    # The queue's URLs hold only a part of the model's name, so they are taken from the reply and never built.
    return JobTicket(
        id=job_id(reply, "request_id"), poll=text_at(reply, "status_url"), result=text_at(reply, "response_url")
    )


def _fal_state(reply: Any) -> JobState:
    if error := value_at(reply, "error"):
        raise JobFailedError(str(error))
    word = text_at(reply, "status")
    ahead = value_at(reply, "queue_position") if word == "IN_QUEUE" else None
    return job_state(word, waiting=("IN_QUEUE", "IN_PROGRESS"), done=("COMPLETED",), failed=(), why="", ahead=ahead)


def _fal_trellis_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    return request.model, {"image_url": request.pictures[0], "seed": SEED}


def _fal_hunyuan_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    return request.model, {"input_image_url": request.pictures[0]}


def _fal_mesh(result: Any, count: int) -> Sequence[MeshReply]:
    del count  # one object a job
    return [MeshReply(url=text_at(result, "model_glb", "url"))]


def _fal_sam3d_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    photo, *masks = request.pictures
    return request.model, {"image_url": photo, "mask_urls": masks, "seed": SEED}


def _fal_sam3d_meshes(result: Any, count: int) -> Sequence[MeshReply]:
    """One mesh per mask: ``individual_glbs`` is there for several masks only."""
    files = value_at(result, "individual_glbs")
    if not files and count == 1:
        files = [value_at(result, "model_glb")]
    if not isinstance(files, list) or len(files) != count:
        found = f"{len(files)} meshes" if isinstance(files, list) else "no list of meshes"
        raise UnexpectedReplyError(f"{found} for {count} masks")
    poses = _fal_sam3d_poses(value_at(result, "metadata"), count)
    return [
        MeshReply(url=text_at({"individual_glbs": file}, "individual_glbs", "url"), pose=pose)
        for file, pose in zip(files, poses, strict=True)
    ]


def _fal_sam3d_poses(metadata: Any, count: int) -> list[Mapping[str, Any] | None]:
    """By mask; None for all where the reply has no poses, and for one whose fields are all null."""
    if metadata is None:
        return [None] * count
    if not isinstance(metadata, list) or len(metadata) != count:
        raise UnexpectedReplyError(f"metadata that is not one pose for each of {count} masks")
    indices = [value_at(entry, "object_index") for entry in metadata]
    if any(isinstance(i, bool) or not isinstance(i, int) for i in indices) or sorted(indices) != list(range(count)):
        raise UnexpectedReplyError(f"metadata whose object_index is not each of 0 to {count - 1} once")
    fields = ("rotation", "translation", "scale")
    by_index = {entry["object_index"]: {name: entry.get(name) for name in fields} for entry in metadata}
    return [None if all(v is None for v in by_index[i].values()) else by_index[i] for i in range(count)]


FAL_SAM3D = HostedService(
    name="fal-sam3d",
    base_url="https://queue.fal.run",
    key_variable="FAL_KEY",
    scheme="Key",
    model="fal-ai/sam-3/3d-objects",
    licence="SAM licence",
    whole_photo=True,
    longest_side=2048,
    submit=_fal_sam3d_submit,
    ticket=_fal_ticket,
    state=_fal_state,
    read=_fal_sam3d_meshes,
)
FAL_TRELLIS2 = HostedService(
    name="fal-trellis2",
    base_url="https://queue.fal.run",
    key_variable="FAL_KEY",
    scheme="Key",
    model="fal-ai/trellis-2",
    licence="TRELLIS.2: MIT",
    submit=_fal_trellis_submit,
    ticket=_fal_ticket,
    state=_fal_state,
    read=_fal_mesh,
)
FAL_HUNYUAN = HostedService(
    name="fal-hunyuan",
    base_url="https://queue.fal.run",
    key_variable="FAL_KEY",
    scheme="Key",
    model="fal-ai/hunyuan-3d/v3.1/pro/image-to-3d",
    licence="the terms of fal and of Tencent Hunyuan 3D",
    submit=_fal_hunyuan_submit,
    ticket=_fal_ticket,
    state=_fal_state,
    read=_fal_mesh,
)

# --- Replicate (source: Replicate's HTTP API reference) ------------------------------------------------------------


def _replicate_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    """``owner/name``, ``owner/name:version`` or a version; ``@FIELD`` names the model's input, "image" by default."""
    version, _, field = request.model.partition("@")
    field, picture = field or "image", request.pictures[0]
    return "v1/predictions", {"version": version, "input": {field: [picture] if field.endswith("s") else picture}}


def _replicate_ticket(reply: Any) -> JobTicket:
    return JobTicket(id=job_id(reply, "id"), poll=text_at(reply, "urls", "get"))


def _replicate_state(reply: Any) -> JobState:
    return job_state(
        text_at(reply, "status"),
        waiting=("starting", "processing"),
        done=("succeeded",),
        failed=("failed", "canceled", "aborted"),
        why=value_at(reply, "error"),
    )


def _replicate_mesh(result: Any, count: int) -> Sequence[MeshReply]:
    """The one GLB of an output, whose form is the model's: a text, a list or an object."""
    del count  # one object a job
    leaves = _texts(value_at(result, "output"), MAX_LEAVES)
    meshes = [text for text in leaves if text.partition("?")[0].lower().endswith(".glb")]
    meshes = meshes or (leaves if len(leaves) == 1 else [])
    if len(meshes) != 1:
        raise UnexpectedReplyError(f"an output with {len(meshes)} GLB files among {len(leaves)} texts")
    return [MeshReply(url=meshes[0])]


def _texts(value: Any, most: int) -> list[str]:
    """All texts of a JSON value, in order."""
    found, stack = list[str](), [value]
    while stack and len(found) < most:
        item = stack.pop()
        if isinstance(item, str):
            found.append(item)
        stack += reversed(list(_inside(item)))
    return found


def _inside(item: Any) -> Iterator[Any]:
    if isinstance(item, dict):
        yield from item.values()
    if isinstance(item, list):
        yield from item


REPLICATE = HostedService(
    name="replicate",
    base_url="https://api.replicate.com",
    key_variable="REPLICATE_API_TOKEN",
    model="tencent/hunyuan-3d-3.1",
    model_form=VERSIONED_MODEL,
    licence="the terms of Replicate and of the model",
    most_picture_bytes=256_000,
    submit=_replicate_submit,
    ticket=_replicate_ticket,
    state=_replicate_state,
    read=_replicate_mesh,
)

# --- Meshy (source: Meshy's API documentation, "Image to 3D") ------------------------------------------------------


def _meshy_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    return "openapi/v1/image-to-3d", {
        "image_url": request.pictures[0],
        "ai_model": request.model,
        "should_texture": True,
        "enable_pbr": False,
    }


def _meshy_ticket(reply: Any) -> JobTicket:
    id = job_id(reply, "result")
    return JobTicket(id=id, poll=f"openapi/v1/image-to-3d/{id}")


def _meshy_state(reply: Any) -> JobState:
    return job_state(
        text_at(reply, "status"),
        waiting=("PENDING", "IN_PROGRESS"),
        done=("SUCCEEDED",),
        failed=("FAILED", "CANCELED", "EXPIRED"),
        why=value_at(reply, "task_error", "message"),
        ahead=value_at(reply, "preceding_tasks"),
    )


def _meshy_mesh(result: Any, count: int) -> Sequence[MeshReply]:
    del count  # one object a job
    return [MeshReply(url=text_at(result, "model_urls", "glb"))]


MESHY = HostedService(
    name="meshy",
    base_url="https://api.meshy.ai",
    key_variable="MESHY_API_KEY",
    model="latest",
    licence="the terms of Meshy, which differ by plan",
    submit=_meshy_submit,
    ticket=_meshy_ticket,
    state=_meshy_state,
    read=_meshy_mesh,
)

# --- Tripo (source: Tripo's API documentation, v2/openapi) ---------------------------------------------------------


def _tripo_token(reply: Any) -> str:
    return job_id(_tripo_accepted(reply), "data", "image_token")


def _tripo_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    body: dict[str, Any] = {
        "type": "image_to_model",
        "file": {"type": "png", "file_token": request.token},
        "texture": True,
        "orientation": "align_image",
    }
    return "v2/openapi/task", body | ({"model_version": request.model} if request.model else {})


def _tripo_ticket(reply: Any) -> JobTicket:
    id = job_id(_tripo_accepted(reply), "data", "task_id")
    return JobTicket(id=id, poll=f"v2/openapi/task/{id}")


def _tripo_accepted(reply: Any) -> Any:
    if (code := value_at(reply, "code")) != 0:
        raise UnexpectedReplyError(f"code {code}: {value_at(reply, 'message')}")
    return reply


def _tripo_state(reply: Any) -> JobState:
    return job_state(
        text_at(_tripo_accepted(reply), "data", "status"),
        waiting=("queued", "running"),
        done=("success",),
        failed=("failed", "cancelled", "banned", "expired", "unknown"),
        why=value_at(reply, "data", "error_msg"),
    )


def _tripo_mesh(result: Any, count: int) -> Sequence[MeshReply]:
    del count  # one object a job
    output = value_at(result, "data", "output")
    name = next((n for n in ("pbr_model", "model", "base_model") if value_at(output, n)), "pbr_model")
    return [MeshReply(url=text_at(output, name))]


TRIPO = HostedService(
    name="tripo",
    base_url="https://api.tripo3d.ai",
    key_variable="TRIPO_API_KEY",
    model="",
    licence="the terms of Tripo, which differ by plan",
    upload_path="v2/openapi/upload",
    uploaded=_tripo_token,
    submit=_tripo_submit,
    ticket=_tripo_ticket,
    state=_tripo_state,
    read=_tripo_mesh,
)

# --- Hunyuan3D's own server (source: api_server.py of Hunyuan3D-2.1) -----------------------------------------------


def _hunyuan_submit(request: HostedRequest) -> tuple[str, Mapping[str, Any]]:
    plain = request.pictures[0].partition(",")[2]
    return "generate", {"image": plain, "texture": True, "seed": SEED}


def _no_job(reply: Any) -> Any:
    raise UnexpectedReplyError("a reply that is no mesh")


def _no_meshes(result: Any, count: int) -> Sequence[MeshReply]:
    raise UnexpectedReplyError(f"a reply without the mesh of {count} objects")


HUNYUAN_SERVER = HostedService(
    name="hunyuan-server",
    base_url="",
    key_variable="",
    model="Hunyuan3D",
    licence=HUNYUAN_LICENCE,
    is_paid=False,
    is_direct=True,
    submit=_hunyuan_submit,
    ticket=_no_job,
    state=_no_job,
    read=_no_meshes,
)

SERVICES = (FAL_SAM3D, FAL_TRELLIS2, FAL_HUNYUAN, REPLICATE, MESHY, TRIPO, HUNYUAN_SERVER)
