"""Asking models: every mode of two APIs over a loopback server, and what may come back instead of an answer."""

from __future__ import annotations

import gzip
import io
import json
import logging
import time
from dataclasses import replace
from importlib.util import find_spec
from typing import Annotated, Any, Literal

import pytest
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field

from f3sr.errors import InputError
from model_servers import Asked, ModelServer, Reply, Script, model_server

if find_spec("pydantic_ai") is None:  # to import it takes half a second in every process that collects
    pytest.skip("the extra llm is not installed", allow_module_level=True)

from f3sr.models.model_client import ModelClient, ModelConfig, ModelError
from f3sr.models.model_endpoint import model_endpoint

KEY = "sk-very/secret+key"
PATIENT = ModelConfig(timeout=60, deadline=120, wait=0.01, reply_bytes=100_000)
"""The first question of a process imports the API's library, and a busy machine answers late."""
HURRIED = replace(PATIENT, timeout=0.4, deadline=1.2)
"""Where the time limit is what is tested."""
PROVIDERS = ("openai", "anthropic")


class Answer(BaseModel):
    model_config = ConfigDict(extra="forbid")

    schema_version: Literal[1]
    id: Annotated[int, Field(ge=0, le=9)]
    speed: Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)]
    words: tuple[str, ...] = ()


GOOD = {"schema_version": 1, "id": 3, "speed": 0.5, "words": ["a"]}


def suits(answer: Answer) -> None:
    if answer.id == 9:
        raise ValueError("there is no object 9; accepted: 0 to 8")


@pytest.fixture(autouse=True)
def key(monkeypatch: pytest.MonkeyPatch) -> None:
    for provider in PROVIDERS:
        monkeypatch.setenv(f"{provider.upper()}_API_KEY", KEY)
        monkeypatch.delenv(f"{provider.upper()}_BASE_URL", raising=False)


def client(server: ModelServer, provider: str = "openai", config: ModelConfig = PATIENT) -> ModelClient:
    return ModelClient.of(f"{provider}:test@{server.url}{'/v1' if provider == 'openai' else ''}", config)


def png(color: tuple[int, int, int]) -> bytes:
    with io.BytesIO() as file:
        Image.new("RGB", (5, 4), color).save(file, "PNG")
        return file.getvalue()


def ask(
    script: Script, provider: str = "openai", config: ModelConfig = PATIENT
) -> tuple[Answer, ModelServer, ModelClient]:
    with model_server(script) as server:
        made = client(server, provider, config)
        parts = ["before", png((255, 0, 0)), "after", png((0, 0, 255))]
        return made.ask("planner", "Do it well.", parts, Answer, suits), server, made


def with_mode(mode: Any) -> ModelConfig:
    return replace(PATIENT, mode=mode)


@pytest.mark.parametrize("provider", PROVIDERS)
@pytest.mark.parametrize("mode", ["json_schema", "tool", "json_object"])
def test_every_mode_of_both_apis_sends_texts_and_pictures(provider: str, mode: str) -> None:
    found, server, made = ask([json.dumps(GOOD)], provider, with_mode(mode))
    assert found == Answer.model_validate(GOOD)
    (asked,) = server.asked
    assert [t for t in asked.texts if t in ("before", "after")] == ["before", "after"]
    assert [image.getpixel((0, 0)) for image in asked.images] == [(255, 0, 0), (0, 0, 255)]
    assert "Do it well." in asked.instructions
    expected = {"anthropic": {"json_object": "text"}}.get(provider, {}).get(mode, mode)
    assert asked.mode == expected
    if mode == "json_object":
        assert '"schema_version"' in asked.instructions, "the schema is told in words"
    else:
        assert "schema_version" in json.dumps(asked.body.get("tools") or asked.body)
    (call,) = made.calls
    assert (call.role, call.model, call.mode, call.attempts) == ("planner", f"{provider}:test", mode, 1)
    assert (call.input_tokens, call.output_tokens) == (11, 7) and len(call.prompt_sha256) == 64
    assert KEY not in repr(made) and KEY not in repr(made.calls) and KEY not in str(made.endpoint)


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_mode_that_an_endpoint_lacks_gives_way_to_the_next(provider: str) -> None:
    def script(asked: Any) -> Reply | str:
        if asked.mode in ("json_schema", "tool"):
            return Reply(status=400, text=f"unsupported: {'response_format' if asked.mode != 'tool' else 'tools'}")
        return json.dumps(GOOD)

    with model_server(script) as server:
        made = client(server, provider)
        assert made.ask("planner", "x", ["y"], Answer).id == 3 and made.mode == "json_object"
        count = len(server.asked)
        assert count == 3 and made.ask("planner", "x", ["y"], Answer).id == 3
        assert len(server.asked) == count + 1, "it is remembered"


def bare(**changed: object) -> str:
    return json.dumps(GOOD | changed)


REPAIRED: dict[str, str | Reply] = {
    "broken JSON": '{"schema_version": 1, "id": 3',
    "single quotes": "{'schema_version': 1}",
    "a comment": '{"schema_version": 1, // yes\n "id": 3, "speed": 1}',
    "a comma too many": '{"schema_version": 1, "id": 3, "speed": 1,}',
    "two objects": f"{bare()} {bare()}",
    "an array of objects": f"[{bare()}]",
    "a text": '"hello"',
    "a number": "42",
    "null": "null",
    "nothing": "",
    "blanks": "  \n ",
    "prose alone": "I cannot see any object.",
    "an unknown id": bare(id=9),
    "an id out of range": bare(id=77),
    "an id below zero": bare(id=-1),
    "a huge id": bare(id=10**300),
    "a number of 5,000 digits": '{"schema_version": 1, "speed": 1, "id": ' + "9" * 5000 + "}",
    "an id with a point": bare(id=3.5),
    "an id as text": bare(id="3"),
    "an id as truth value": bare(id=True),
    "a speed out of range": bare(speed=1e9),
    "a speed below zero": bare(speed=-1),
    "NaN": '{"schema_version": 1, "id": 3, "speed": NaN}',
    "Infinity": '{"schema_version": 1, "id": 3, "speed": Infinity}',
    "1e400": '{"schema_version": 1, "id": 3, "speed": 1e400}',
    "a speed as text": bare(speed="fast"),
    "a number in quotes": bare(speed="0.5"),
    "a speed of null": bare(speed=None),
    "a speed as list": bare(speed=[1]),
    "words as text": bare(words="a"),
    "words as object": bare(words={"a": 1}),
    "a number among words": bare(words=["a", 1]),
    "a field more": bare(bodies=[{"id": 100}]),
    "a dunder": bare(__class__="os"),
    "a field less": json.dumps({"schema_version": 1, "id": 3}),
    "a key twice": '{"schema_version": 1, "id": 3, "id": 4, "speed": 1}',
    "schema version 2": bare(schema_version=2),
    "schema version as text": bare(schema_version="1"),
    "no schema version": json.dumps({"id": 3, "speed": 1}),
    "nested deeply": '{"a":' * 3000 + "1" + "}" * 3000,
    "inside another object": json.dumps({"answer": GOOD}),
    "a lone surrogate": '{"schema_version": 1, "id": 3, "speed": "\\ud800"}',
    "cut off": Reply(text=bare(), finish="length"),
}


@pytest.mark.parametrize("name", REPAIRED)
def test_an_answer_that_does_not_suit_goes_back_once(name: str) -> None:
    found, server, made = ask([REPAIRED[name], bare()])
    assert found.id == 3 and len(server.asked) == 2 and made.calls[0].attempts == 2
    assert any("does not suit" in text for text in server.asked[1].texts)
    assert len(server.asked[1].images) == 2, "the evidence is still there"
    with pytest.raises(ModelError) as error:
        ask([REPAIRED[name]])
    assert str(error.value).isprintable() and KEY not in str(error.value)


@pytest.mark.parametrize("mode", ["json_schema", "tool"])
def test_a_key_in_an_answer_is_cut_out(mode: str) -> None:
    found, _, made = ask([bare(words=[f"the key is {KEY}", "a"])], config=with_mode(mode))
    assert found.words[0] == "the key is [key]" and KEY not in repr(made.calls)


TOOLS: dict[str, Reply] = {
    "an unknown tool": Reply(text=bare(), tool="run_shell"),
    "two calls": Reply(text=bare(), calls=2),
    "a call that does not suit": Reply(text=bare(id=9)),
    "a call without arguments": Reply(text="{}"),
}


@pytest.mark.parametrize("provider", PROVIDERS)
@pytest.mark.parametrize("name", TOOLS)
def test_a_call_of_a_tool_that_does_not_suit_goes_back_once(name: str, provider: str) -> None:
    found, server, _ = ask([TOOLS[name], bare()], provider, with_mode("tool"))
    assert found.id == 3 and len(server.asked) == 2
    with pytest.raises(ModelError):
        ask([TOOLS[name]], provider, with_mode("tool"))


TOLERATED: dict[str, str] = {
    "prose around it": f"Here you are:\n{bare()}\nGood luck!",
    "a fence": f"```json\n{bare()}\n```",
    "a fence without a name": f"Sure.\n```\n{bare()}\n```",
    "a byte order mark": "\ufeff" + bare(),
    "white space": f"\n\n  {json.dumps(GOOD, indent=4)}  \n",
}


@pytest.mark.parametrize("name", TOLERATED)
def test_words_around_one_object_are_tolerated(name: str) -> None:
    found, server, _ = ask([TOLERATED[name]])
    assert found.id == 3 and len(server.asked) == 1


PASSES: dict[str, Reply] = {
    "429": Reply(status=429, text="slow down"),
    "429 with a time": Reply(status=429, text="slow down", headers={"Retry-After": "0"}),
    "500": Reply(status=500, text="oops"),
    "503": Reply(status=503, text="busy"),
    "529": Reply(status=529, text="overloaded"),
    "dropped": Reply(drop=True),
    "slow": Reply(text=bare(), delay=1.0),
    "half an answer": Reply(text=bare(), length=5000),
}


@pytest.mark.parametrize("provider", PROVIDERS)
@pytest.mark.parametrize("name", PASSES)
def test_failures_of_communication_are_retried(name: str, provider: str) -> None:
    is_late = PASSES[name].delay > 0
    found, server, made = ask([PASSES[name], bare()], provider, HURRIED if is_late else PATIENT)
    assert found.id == 3 and len(server.asked) == 2 and made.calls[0].attempts == 2
    if is_late or name == "half an answer":
        return
    with pytest.raises(ModelError) as error, model_server([PASSES[name]]) as server:
        client(server, provider).ask("planner", "x", ["y"], Answer)
    assert len(server.asked) == 1 + PATIENT.retries and str(error.value).isprintable()


ENDS: dict[str, Reply] = {
    "400": Reply(status=400, text=f"bad request of {KEY}"),
    "401": Reply(status=401, text=f"Incorrect API key provided: {KEY}"),
    "401 with the key in an odd place": Reply(status=401, body=f'{{"error": "{KEY}"}}'.encode()),
    "401 with the key as in URLs": Reply(status=401, text="sk-very%2Fsecret%2Bkey is wrong"),
    "402": Reply(status=402, text="no credit"),
    "403": Reply(status=403, text="forbidden"),
    "404": Reply(status=404, text="no such model"),
    "413": Reply(status=413, text="too large"),
    "redirected": Reply(status=302, text="", headers={"Location": "http://127.0.0.1:9/"}),
    "filtered": Reply(text="", finish="content_filter"),
    "5 MB": Reply(text="x" * 5_000_000),
    "endless": Reply(endless=True),
    "a bomb": Reply(body=gzip.compress(b" " * 50_000_000), headers={"Content-Encoding": "gzip"}),
    "dripping": Reply(text=bare(), drip=0.05),
    "HTML": Reply(body=b"<html><body>Welcome</body></html>"),
    "no UTF-8": Reply(body=b"\xff\xfe\x00{"),
    "an empty body": Reply(body=b""),
    "JSON of nothing": Reply(body=b"{}"),
    "a list": Reply(body=b"[1, 2]"),
    "no choices": Reply(body=b'{"id": "x", "choices": [], "model": "m", "object": "chat.completion", "created": 1}'),
    "null choices": Reply(body=b'{"id": "x", "choices": null, "content": null, "model": "m", "usage": null}'),
    "nested deeply": Reply(body=b'{"a":' * 20000 + b"1" + b"}" * 20000),
}


@pytest.mark.parametrize("provider", PROVIDERS)
@pytest.mark.parametrize("name", ENDS)
def test_what_is_no_answer_ends_with_one_line(
    name: str, provider: str, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    is_slow = ENDS[name].drip > 0 or ENDS[name].endless
    start = time.perf_counter()
    with pytest.raises(ModelError) as error:
        ask([ENDS[name]], provider, HURRIED if is_slow else PATIENT)
    assert not is_slow or time.perf_counter() - start < 3.5, "within the deadline"
    told = [str(error.value), repr(error.value), capfd.readouterr().err, caplog.text]
    at: BaseException | None = error.value
    while at is not None:
        told.append(f"{at} {at!r}")
        at = at.__cause__ or (None if at.__suppress_context__ else at.__context__)
    assert not any(KEY in text or "secret%2Bkey" in text for text in told)
    assert str(error.value).isprintable() and "\n" not in str(error.value) and told[2] == ""


def test_limits_are_checked_before_each_request() -> None:
    for limit, name in (({"requests": 1}, "requests"), ({"tokens": 18}, "tokens")):
        config = replace(PATIENT, **limit)
        with model_server([bare()]) as server:
            made = client(server, config=config)
            assert made.ask("planner", "x", ["y"], Answer).id == 3
            with pytest.raises(ModelError, match=f"limit of .* {name}"):
                made.ask("planner", "x", ["y"], Answer)
            assert len(server.asked) == 1


def test_temperature_seed_and_key_are_sent_where_they_exist() -> None:
    _, server, _ = ask([bare()])
    assert server.asked[0].body["temperature"] == 0 and server.asked[0].body["seed"] == 0
    assert server.asked[0].headers["authorization"] == f"Bearer {KEY}"
    assert server.asked[0].headers["accept-encoding"] == "identity"
    _, server, _ = ask([bare()], "anthropic")
    assert server.asked[0].body["temperature"] == 0 and "seed" not in server.asked[0].body
    sent = server.asked[0].headers.get("x-api-key"), server.asked[0].headers.get("authorization")
    assert KEY in str(sent) and not server.asked[0].body.get("stream")


@pytest.mark.parametrize("provider", PROVIDERS)
def test_settings_that_a_model_does_not_know_are_left_out(provider: str) -> None:
    def script(asked: Asked) -> Reply | str:
        if "temperature" in asked.body:
            return Reply(status=400, text="Unsupported value: 'temperature' does not support 0 with this model")
        return Reply(status=400, text="unknown field seed") if "seed" in asked.body else bare()

    with model_server(script) as server:
        made = client(server, provider)
        for _ in range(2):
            assert made.ask("planner", "x", ["y"], Answer).id == 3
        assert len(server.asked) == (4 if provider == "openai" else 3), "it is remembered"
        assert made.mode == "json_schema"


@pytest.mark.parametrize("provider", PROVIDERS)
def test_no_other_headers_are_sent(provider: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither those of environment variables, which may hold other keys, nor those that tell of the machine."""
    other = "Authorization: Bearer other-secret\nX-Other: other-secret"
    monkeypatch.setenv(f"{provider.upper()}_CUSTOM_HEADERS", other)
    _, server, _ = ask([bare()], provider)
    sent = server.asked[0].headers
    assert "other-secret" not in str(sent) and KEY in str(sent)
    assert not [name for name in sent if name.startswith("x-stainless") or name == "x-other"]


SPECS = {
    "": "openai:NAME",
    "gpt": "openai:NAME",
    "openai:": "openai:NAME",
    "google:gemini": "openai:NAME",
    "openai:a b": "openai:NAME",
    "openai:x@ftp://host": "http or https",
    "openai:x@http://": "http or https",
    "openai:x@http://user:sk-secret@host/v1": "without user",
    "openai:x@http://host/v1?key=sk-secret": "without user",
    "openai:x@file:///etc/passwd": "http or https",
    "openai:x@http://[::1": "http or https",
}


@pytest.mark.parametrize("spec", SPECS)
def test_a_spec_that_is_none_is_told_in_one_line(spec: str) -> None:
    with pytest.raises(InputError) as error:
        model_endpoint(spec)
    assert SPECS[spec] in str(error.value) and "secret" not in str(error.value)


def test_the_doctor_tells_of_keys_but_not_which() -> None:
    from f3sr.cli import doctor

    found = {check.name: check for check in doctor.examine() if check.group == "models"}
    assert found["openai"].state == "ok" and "OPENAI_API_KEY" in found["openai"].found
    assert not any(KEY in check.found for check in found.values())


def test_keys_come_from_the_environment_only(monkeypatch: pytest.MonkeyPatch) -> None:
    assert KEY not in repr(model_endpoint("openai:gpt")) and model_endpoint("openai:gpt").host == "api.openai.com"
    monkeypatch.setenv("OPENAI_BASE_URL", "https://example.org/v1")
    assert model_endpoint("openai:gpt").host == "example.org"
    monkeypatch.delenv("OPENAI_API_KEY")
    with pytest.raises(InputError, match="OPENAI_API_KEY"):
        model_endpoint("openai:gpt")
    assert model_endpoint("openai:llama@http://localhost:11434/v1").host == "localhost:11434"
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    assert model_endpoint("openai:llama@http://localhost:11434/v1").key == KEY
    assert model_endpoint("openai:llama@http://192.168.1.7:8000/v1").key != KEY, "in clear to another machine"
    assert model_endpoint("openai:llama@https://example.org/v1").key == KEY
    told = model_endpoint("openai:gpt").redacted(f"key {KEY[:14]}... is wrong, so is ...{KEY[-13:]}")
    assert KEY[:12] not in told and KEY[-12:] not in told
    monkeypatch.setenv("OPENAI_API_KEY", "sk-\u00fc\n")
    with pytest.raises(InputError, match="no key has"):
        model_endpoint("openai:gpt")
