"""One typed question to a model: answered by a record that suits, or ended with one clear error."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import threading
import time
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from annotated_types import Interval
from pydantic import BaseModel, ValidationError

from f3sr.errors import F3srError, InputError, NoAnswerError
from f3sr.files import strict_json
from f3sr.models.model_endpoint import NO_KEY, ModelEndpoint, model_endpoint
from f3sr.settings import settings

if TYPE_CHECKING:
    from pydantic_ai.messages import ModelMessage, ModelResponse
    from pydantic_ai.models import Model

M = TypeVar("M", bound=BaseModel)
T = TypeVar("T")
Mode = Literal["json_schema", "tool", "json_object"]
LADDER: tuple[Mode, ...] = ("json_schema", "tool", "json_object")
TOOL = "answer"
"""Name of the tool that a model calls with its answer, and of the schema."""
UNSUPPORTED = re.compile(r"response_format|json_schema|structured|output_config|output_format|tool|strict|schema", re.I)
"""What an endpoint names that does not know a mode."""
NOT_ASKED = (400, 404, 415, 422, 501)
"""Status codes with which it says so."""
AGAIN = (408, 409, 425, 429, 500, 502, 503, 504, 529)
"""Status codes of failures that pass."""
FENCE = re.compile(r"```(?:json)?\s*(.*?)```", re.S)


class ModelError(NoAnswerError):
    """A model gave no answer that suits, or a limit was reached; one line says which model and why."""


@settings
class ModelConfig:
    """How a model is asked, and how much of it."""

    timeout: Annotated[float, Interval(gt=0, le=3600)] = 120.0
    """Longest time of one request [s]: reasoning models think for a minute."""
    deadline: Annotated[float, Interval(gt=0, le=3600)] = 300.0
    """Longest time of a question with retries and repair [s]."""
    max_tokens: Annotated[int, Interval(ge=64, le=200_000)] = 8192
    """Tokens of one answer: the properties of 50 objects take 4,000."""
    temperature: Annotated[float, Interval(ge=0, le=2)] | None = 0.0
    """Sampling temperature; None where a model takes none."""
    seed: int | None = 0
    """Of sampling, where the provider has it."""
    requests: Annotated[int, Interval(ge=1, le=100_000)] = 200
    """Requests of a client at most."""
    tokens: Annotated[int, Interval(ge=1, le=10**9)] = 2_000_000
    """Tokens in and out of a client at most."""
    cost: Annotated[float, Interval(gt=0, le=10**6)] = 20.0
    """Cost of a client at most [USD], as far as prices are known."""
    reply_bytes: Annotated[int, Interval(ge=1000, le=100_000_000)] = 1_000_000
    """Bytes of a reply at most: an answer has some ten thousand."""
    retries: Annotated[int, Interval(ge=0, le=10)] = 2
    """Further requests after failures of communication, which pass."""
    wait: Annotated[float, Interval(ge=0, le=60)] = 2.0
    """Time before the first of them [s], doubled before each other one."""
    mode: Literal["auto", "json_schema", "tool", "json_object"] = "auto"
    """How the form of an answer is asked for; auto takes the first that the endpoint knows."""


@dataclass(frozen=True, kw_only=True)
class Call:
    """A question as it was asked and answered: what it cost, and digests of what was shown and said."""

    role: str
    model: str
    host: str
    mode: str
    prompt_sha256: str
    reply_sha256: str
    input_tokens: int
    output_tokens: int
    cost: float | None
    """[USD]; None where the price is not known."""
    seconds: float
    attempts: int


@dataclass(eq=False)
class ModelClient:
    """A model with its limits; ``calls`` are all questions so far."""

    endpoint: ModelEndpoint
    config: ModelConfig
    mode: Mode
    calls: list[Call] = field(default_factory=list[Call])
    requests: int = 0
    without: set[str] = field(default_factory=set[str])
    """Settings that the endpoint does not know: reasoning models take no temperature."""

    @classmethod
    def of(cls, spec: str, config: ModelConfig | None = None) -> ModelClient:
        """The client of a spec. Raises InputError for a bad spec, without a key, and without the extra ``llm``."""
        require_extra()
        config = config or ModelConfig()
        return cls(model_endpoint(spec), config, LADDER[0] if config.mode == "auto" else config.mode)

    def ask(
        self,
        role: str,
        instructions: str,
        parts: Sequence[str | bytes],
        answer: type[M],
        check: Callable[[M], None] | None = None,
    ) -> M:
        """The answer to texts and PNG pictures. ``check`` raises ValueError with what does not suit; that, and an
        answer of another form, goes back to the model once. Raises ModelError."""
        question = _Question(self, role, instructions, parts, answer, check)
        try:
            return _in_own_thread(question.asked)
        except F3srError:
            raise
        except Exception as error:  # SDKs raise anything for what servers send
            raise ModelError(f"{self.endpoint}: {self.endpoint.redacted(_said(error))}") from None

    def unknown_settings(self, text: str) -> set[str]:
        """Settings that an endpoint's error names and that were sent."""
        return {name for name in ("temperature", "seed") if name in text.lower()} - self.without

    def require_budget(self) -> None:
        """Raises ModelError where a limit is reached."""
        tokens = sum(c.input_tokens + c.output_tokens for c in self.calls)
        cost = sum(c.cost or 0.0 for c in self.calls)
        for name, spent, most in (
            ("requests", self.requests, self.config.requests),
            ("tokens", tokens, self.config.tokens),
            ("USD", cost, self.config.cost),
        ):
            if spent >= most:
                raise ModelError(f"{self.endpoint}: the limit of {most:,} {name} is reached")


def require_extra() -> None:
    """Raises InputError without the packages that ask models."""
    try:
        from pydantic_ai.models import anthropic, openai  # noqa: F401  # pyright: ignore[reportUnusedImport]
    except ImportError as error:
        found = f"no package {error.name or 'pydantic_ai'}"
        raise InputError("--model", found=found, accepted="the extra llm: pip install 'f3sr[llm]'") from None


def answered(endpoint: ModelEndpoint, config: ModelConfig, work: Callable[[Any], Coroutine[Any, Any, T]]) -> T:
    """The result of one piece of work with a limited HTTP client, within the deadline. Raises ModelError."""

    async def asked() -> T:
        from f3sr.models.limited_transport import limited_client

        async with limited_client(config.reply_bytes, endpoint.key) as http, asyncio.timeout(config.timeout):
            return await work(http)

    try:
        return _in_own_thread(asked)
    except F3srError:
        raise
    except TimeoutError:
        raise ModelError(f"{endpoint}: no reply within {config.timeout:g} s") from None
    except Exception as error:  # SDKs raise anything for what servers send
        raise ModelError(f"{endpoint}: {endpoint.redacted(_said(error))}") from None


class _ModeRefusedError(Exception):
    """The endpoint does not know a mode."""


@dataclass(eq=False)
class _Question:
    """One question: modes, retries and a repair, within its deadline."""

    client: ModelClient
    role: str
    instructions: str
    parts: Sequence[str | bytes]
    answer: type[BaseModel]
    check: Callable[[Any], None] | None
    attempts: int = 0
    input_tokens: int = 0
    output_tokens: int = 0
    cost: float | None = None
    reply: bytes = b""

    async def asked(self) -> Any:
        start, ended = time.perf_counter(), False
        try:
            async with asyncio.timeout(self.client.config.deadline):
                found = await self._by_modes()
                ended = True
                return found
        except TimeoutError:
            seconds = self.client.config.deadline
            raise ModelError(f"{self.client.endpoint}: no answer of the {self.role} within {seconds:g} s") from None
        finally:
            if self.attempts or ended:
                self._note(time.perf_counter() - start)

    async def _by_modes(self) -> Any:
        client = self.client
        while True:
            try:
                return await self._repaired()
            except _ModeRefusedError as refusal:
                at = LADDER.index(client.mode) + 1
                if client.config.mode != "auto" or at == len(LADDER):
                    raise ModelError(f"{client.endpoint}: {client.endpoint.redacted(str(refusal))}") from None
                client.mode = LADDER[at]

    async def _repaired(self) -> Any:
        """The first answer that suits, of two."""
        messages = self._messages()
        response = await self._requested(messages)
        try:
            return self._suits(response)
        except ValueError as fault:
            messages += [response, self._fault(response, str(fault))]
        response = await self._requested(messages)
        try:
            return self._suits(response)
        except ValueError as fault:
            said = self.client.endpoint.redacted(str(fault))
            raise ModelError(f"{self.client.endpoint}: the {self.role}'s answer does not suit: {said}") from None

    def _messages(self) -> list[ModelMessage]:
        from pydantic_ai.messages import BinaryContent, ModelRequest, UserPromptPart

        content = [p if isinstance(p, str) else BinaryContent(data=p, media_type="image/png") for p in self.parts]
        instructions = self.instructions
        if self.client.mode == "json_object":
            schema = json.dumps(self.answer.model_json_schema())
            instructions = f"{instructions}\nThe JSON schema of your answer:\n{schema}"
        return [ModelRequest(parts=[UserPromptPart(content=content)], instructions=instructions)]

    def _fault(self, response: ModelResponse, fault: str) -> ModelMessage:
        """What is wrong with an answer, as the provider wants it told."""
        from pydantic_ai.messages import ModelRequest, ToolCallPart, ToolReturnPart, UserPromptPart

        words = f"Your answer does not suit: {fault[:1000]}\nGive the whole answer again, corrected."
        calls = [part for part in response.parts if isinstance(part, ToolCallPart)]
        if not calls:
            return ModelRequest(parts=[UserPromptPart(content=words)], instructions=self._instructions())
        told = [
            ToolReturnPart(tool_name=c.tool_name, content=words, tool_call_id=c.tool_call_id, outcome="retried")
            for c in calls
        ]
        return ModelRequest(parts=told, instructions=self._instructions())

    def _instructions(self) -> str | None:
        return self._messages()[0].instructions  # type: ignore[union-attr]

    async def _requested(self, messages: list[ModelMessage]) -> ModelResponse:
        """One reply, after retries of what passes."""
        from pydantic_ai.exceptions import ModelAPIError, ModelHTTPError

        from f3sr.models.limited_transport import ReplyTooLongError

        client, wait, failure = self.client, self.client.config.wait, ""
        for left in range(client.config.retries, -1, -1):
            client.require_budget()
            client.requests += 1
            self.attempts += 1
            try:
                async with asyncio.timeout(client.config.timeout):
                    return self._counted(await self._request(messages))
            except TimeoutError:
                failure = f"no reply within {client.config.timeout:g} s"
            except ModelHTTPError as error:
                text = f"HTTP {error.status_code}: {_body(error.body)}"
                if error.status_code in NOT_ASKED and (unknown := client.unknown_settings(text)):
                    client.without |= unknown
                    return await self._requested(messages)
                if error.status_code in NOT_ASKED and UNSUPPORTED.search(text):
                    raise _ModeRefusedError(text) from None
                if error.status_code not in AGAIN:
                    raise ModelError(f"{client.endpoint}: {client.endpoint.redacted(text)}") from None
                failure, wait = text, _retry_after(error.headers, wait)
            except ModelAPIError as error:
                failure = _said(error)
                if any(isinstance(cause, ReplyTooLongError) for cause in _causes(error)):
                    break
            if left:
                await asyncio.sleep(wait)
                wait *= 2
        raise ModelError(f"{client.endpoint}: {client.endpoint.redacted(failure)}")

    async def _request(self, messages: list[ModelMessage]) -> ModelResponse:
        from pydantic_ai.models import ModelRequestParameters
        from pydantic_ai.output import OutputObjectDefinition
        from pydantic_ai.settings import ModelSettings
        from pydantic_ai.tools import ToolDefinition

        from f3sr.models.limited_transport import limited_client

        config, schema, mode = self.client.config, self.answer.model_json_schema(), self.client.mode
        loose = False if self.client.endpoint.provider == "openai" else None  # strict would need every field
        wanted: dict[Mode, ModelRequestParameters] = {
            "json_schema": ModelRequestParameters(
                output_mode="native",
                output_object=OutputObjectDefinition(json_schema=schema, name=TOOL, strict=loose),
                allow_text_output=True,
            ),
            "tool": ModelRequestParameters(
                output_mode="tool",
                output_tools=[
                    ToolDefinition(
                        name=TOOL, parameters_json_schema=schema, description="Give your answer.", kind="output"
                    )
                ],
                allow_text_output=False,
            ),
            "json_object": ModelRequestParameters(output_mode="text"),
        }
        chosen = ModelSettings(max_tokens=config.max_tokens, timeout=config.timeout)
        if config.temperature is not None and "temperature" not in self.client.without:
            chosen["temperature"] = config.temperature
        has_seed = self.client.endpoint.provider == "openai" and "seed" not in self.client.without
        if config.seed is not None and has_seed:
            chosen["seed"] = config.seed
        async with limited_client(config.reply_bytes, self.client.endpoint.key) as http:
            model = _model(self.client.endpoint, http)
            if mode == "json_object" and self.client.endpoint.provider == "openai":
                chosen["extra_body"] = {"response_format": {"type": "json_object"}}
            return await model.request(messages, chosen, wanted[mode])

    def _counted(self, response: ModelResponse) -> ModelResponse:
        self.input_tokens += max(0, int(response.usage.input_tokens or 0))
        self.output_tokens += max(0, int(response.usage.output_tokens or 0))
        try:
            price = float(response.cost().total_price)
        except Exception:  # prices are known for some models only
            price = None
        if price is not None:
            self.cost = (self.cost or 0.0) + price
        return response

    def _suits(self, response: ModelResponse) -> Any:
        """The answer of a reply. Raises ValueError with what is wrong."""
        if response.finish_reason == "length":
            raise ValueError(f"it is cut off after {self.client.config.max_tokens:,} tokens; accepted: a shorter one")
        if response.finish_reason == "content_filter":
            raise ModelError(f"{self.client.endpoint}: the provider's filter refused to answer as {self.role}")
        text = self.client.endpoint.redacted(_text_of(response))  # answers go into files
        self.reply = text.encode("utf-8", "replace")
        values = _one_object(text)
        try:
            found = self.answer.model_validate_json(json.dumps(values), strict=True)
        except ValidationError as error:
            found, accepted = strict_json.problem(error, ", ".join(self.answer.model_fields))
            raise ValueError(f"{found}; accepted: {accepted}") from None
        except RecursionError:
            raise ValueError("nested too deeply") from None
        if self.check is not None:
            self.check(found)
        return found

    def _note(self, seconds: float) -> None:
        shown = hashlib.sha256(self.instructions.encode())
        for part in self.parts:
            shown.update(part.encode("utf-8", "replace") if isinstance(part, str) else part)
        endpoint = self.client.endpoint
        self.client.calls.append(
            Call(
                role=self.role,
                model=str(endpoint),
                host=endpoint.host,
                mode=self.client.mode,
                prompt_sha256=shown.hexdigest(),
                reply_sha256=hashlib.sha256(self.reply).hexdigest(),
                input_tokens=self.input_tokens,
                output_tokens=self.output_tokens,
                cost=self.cost,
                seconds=round(seconds, 3),
                attempts=self.attempts,
            )
        )


def _model(endpoint: ModelEndpoint, http: Any) -> Model[Any]:
    """pydantic-ai's model over a client that retries nothing itself."""
    import pydantic_ai

    pydantic_ai.BANNER_ENABLED = False
    key = endpoint.key or NO_KEY
    if endpoint.provider == "openai":
        from openai import AsyncOpenAI
        from pydantic_ai.models.openai import OpenAIChatModel
        from pydantic_ai.profiles.openai import OpenAIModelProfile
        from pydantic_ai.providers.openai import OpenAIProvider

        client = AsyncOpenAI(api_key=key, base_url=endpoint.url, http_client=http, max_retries=0)
        profile = OpenAIModelProfile(supports_json_schema_output=True, supports_tools=True)
        return OpenAIChatModel(endpoint.name, provider=OpenAIProvider(openai_client=client), profile=profile)
    from anthropic import AsyncAnthropic
    from pydantic_ai.models.anthropic import AnthropicModel
    from pydantic_ai.profiles import ModelProfile
    from pydantic_ai.providers.anthropic import AnthropicProvider

    anthropic = AsyncAnthropic(
        api_key=key,
        base_url=endpoint.url,
        http_client=http,
        max_retries=0,
        open_telemetry=False,
    )
    profile = ModelProfile(supports_json_schema_output=True, supports_tools=True)
    return AnthropicModel(endpoint.name, provider=AnthropicProvider(anthropic_client=anthropic), profile=profile)


def _text_of(response: ModelResponse) -> str:
    """What a reply says: the arguments of the one call of our tool, or its text."""
    from pydantic_ai.messages import TextPart, ToolCallPart

    calls = [part for part in response.parts if isinstance(part, ToolCallPart)]
    if len(calls) > 1 or any(call.tool_name != TOOL for call in calls):
        raise ValueError(f"calls of {', '.join(c.tool_name[:40] for c in calls[:4])}; accepted: one call of {TOOL}")
    if calls:
        return calls[0].args if isinstance(calls[0].args, str) else json.dumps(calls[0].args)
    return "".join(part.content for part in response.parts if isinstance(part, TextPart))


def _one_object(text: str) -> Any:
    """The one JSON object of a text, alone, in a fence, or with prose around it. Raises ValueError."""
    stripped = text.strip().removeprefix("\ufeff")
    if not stripped:
        raise ValueError("it is empty; accepted: one JSON object")
    fenced = FENCE.findall(stripped)
    inner = fenced[0] if len(fenced) == 1 else stripped
    start, end = inner.find("{"), inner.rfind("}")
    if start < 0 or end < start:
        raise ValueError("it has no JSON object; accepted: one JSON object")
    values = strict_json.loads(inner[start : end + 1].encode("utf-8", "surrogatepass"))
    if not isinstance(values, dict) or inner[:start].rstrip().endswith("["):
        raise ValueError("it is no JSON object; accepted: one JSON object")
    return values  # type: ignore[reportUnknownVariableType]


def _causes(error: BaseException) -> list[BaseException]:
    """An error and what it comes from, the last one first."""
    found = [error]
    while len(found) < 8 and (cause := found[-1].__cause__ or found[-1].__context__) is not None:
        found.append(cause)
    return found


def _said(error: BaseException) -> str:
    """The words of an error and its causes, on one line."""
    words = dict.fromkeys(said for cause in _causes(error) if (said := str(cause).strip()))
    return "; ".join(" ".join(w.split())[:300] for w in words) or type(error).__name__


def _body(body: object) -> str:
    """What a server says of an error, short."""
    if isinstance(body, dict):
        inner: Any = body.get("error", body)  # type: ignore[reportUnknownVariableType, reportUnknownMemberType]
        message = inner.get("message") if isinstance(inner, dict) else inner  # type: ignore[reportUnknownMemberType]
        return str(message if message is not None else inner)[:300]
    return " ".join(str(body).split())[:300] if body is not None else "no reason given"


def _retry_after(headers: dict[str, str] | None, wait: float) -> float:
    """Seconds to wait before a retry: what the server asks for, at most a minute."""
    asked = (headers or {}).get("retry-after", "")
    return min(60.0, float(asked)) if re.fullmatch(r"\d{1,6}(\.\d+)?", asked) else wait


def _in_own_thread(work: Callable[[], Any]) -> Any:
    """The result of a coroutine on a loop of its own: callers may be on one already."""
    found: list[Any] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            found.append(asyncio.run(work()))
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return found[0]
