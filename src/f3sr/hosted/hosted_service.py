"""The description of a service: data, and the few functions that know its wire format."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from f3sr.backends.protocols import Axis

ID = re.compile(r"[A-Za-z0-9][\w.-]{0,199}", re.ASCII)
"""What an id of a job may be: it becomes a part of URLs and messages."""
MODEL = re.compile(r"\w[\w.-]*(/\w[\w.-]*){0,6}", re.ASCII)
"""What a model's name may be: it becomes a part of URLs."""
VERSIONED_MODEL = re.compile(MODEL.pattern + r"(:\w+)?(@\w+)?", re.ASCII)
"""The same with a version, and with the name of the input that takes the picture."""


class UnexpectedReplyError(Exception):
    """A reply of another form than the service's documentation gives."""


class JobFailedError(Exception):
    """The service says that the job has failed: it will give no mesh."""


@dataclass(frozen=True, eq=False, kw_only=True)
class HostedRequest:
    """What one job is asked for: one object, or all of a photo."""

    model: str
    pictures: Sequence[str]
    """Data URIs: a cut-out, or the photo followed by a mask per object."""
    token: str = ""
    """What the service called the picture that was uploaded before."""


@dataclass(frozen=True, kw_only=True)
class JobTicket:
    """Where a job that was accepted is asked for."""

    id: str
    poll: str
    """URL or path of its state, at the API's own host."""
    result: str = ""
    """URL or path of its result, where that is not in its state."""


@dataclass(frozen=True, kw_only=True)
class JobState:
    """What a service says of a job."""

    stage: Literal["waiting", "done"]
    words: str
    """The service's word for it, and its place in the queue."""


MOST_AHEAD = 1_000_000
"""Longest queue that is believed."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshReply:
    """A mesh that can be downloaded."""

    url: str
    pose: Mapping[str, Any] | None = None
    """rotation, translation and scale as SAM 3D Objects gives them, unchecked."""


@dataclass(frozen=True, eq=False, kw_only=True)
class HostedService:
    """A service as data and functions. The functions raise UnexpectedReplyError or JobFailedError."""

    name: str
    """Of its producer, as ``--assets`` takes it."""
    base_url: str
    """Of its API; empty where the user gives it. Nothing else gets the key."""
    key_variable: str
    """The environment variable of the key; empty where there is none."""
    scheme: Literal["Key", "Bearer"] = "Bearer"
    """Of the Authorization header."""
    model: str
    """What is run unless the user names another."""
    model_form: re.Pattern[str] = MODEL
    """Of the name that the user may give instead."""
    licence: str
    """Of what comes back, for the report."""
    up: Axis | None = "+y"
    """The axis of its files that points up."""
    whole_photo: bool = False
    """Whether one job takes the photo with all masks; else there is one job per object."""
    least_side: int = 256
    longest_side: int = 1024
    """Of the pictures that are sent [px]."""
    most_picture_bytes: int = 5_000_000
    is_paid: bool = True
    is_direct: bool = False
    """Whether the reply to the request is the mesh itself."""
    upload_path: str = ""
    """Where the picture is uploaded first; empty where it is part of the request."""
    uploaded: Callable[[Any], str] | None = None
    """Reply to an upload to the picture's token."""
    submit: Callable[[HostedRequest], tuple[str, Mapping[str, Any]]]
    """Path and JSON body of a request."""
    ticket: Callable[[Any], JobTicket]
    """Reply to a request to its job."""
    state: Callable[[Any], JobState]
    """Reply to a poll to the job's state."""
    read: Callable[[Any, int], Sequence[MeshReply]]
    """Result and number of objects to as many meshes, in the objects' order."""


def job_id(reply: Any, *path: str) -> str:
    """The id at a path of a reply. Raises UnexpectedReplyError for anything that is none."""
    value = text_at(reply, *path)
    if not ID.fullmatch(value) or ".." in value:
        raise UnexpectedReplyError(f"{'.'.join(path)} is no id")
    return value


def text_at(reply: Any, *path: str) -> str:
    """The text at a path of a reply. Raises UnexpectedReplyError where there is none."""
    value = value_at(reply, *path)
    if not isinstance(value, str) or not value:
        raise UnexpectedReplyError(f"no {'.'.join(path)}")
    return value


def value_at(reply: Any, *path: str) -> Any:
    """The value at a path of a reply, or None."""
    for name in path:
        reply = reply.get(name) if isinstance(reply, dict) else None
    return reply


def job_state(
    word: str, *, waiting: Sequence[str], done: Sequence[str], failed: Sequence[str], why: Any, ahead: Any = None
) -> JobState:
    """The state that a service's word means; ``ahead`` is the number of jobs that it does before, where it tells one.

    Raises JobFailedError with ``why``, UnexpectedReplyError otherwise."""
    if word in failed:
        raise JobFailedError(f"{word}: {why}" if why else word)
    if word in done:
        return JobState(stage="done", words=word)
    if word in waiting:
        queue = f", {ahead} ahead of it" if type(ahead) is int and 0 <= ahead <= MOST_AHEAD else ""
        return JobState(stage="waiting", words=f"{word}{queue}")
    raise UnexpectedReplyError(f"an unknown state {word!r}")
