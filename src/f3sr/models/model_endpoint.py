"""Where a model is: provider, name and base URL from a spec on the command line; the key from the environment only."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import quote, urlsplit

from f3sr.errors import InputError, cut

Provider = Literal["openai", "anthropic"]

ACCEPTED = "openai:NAME, anthropic:NAME, or openai:NAME@URL for a server that speaks OpenAI's API"
KEYS: dict[Provider, str] = {"openai": "OPENAI_API_KEY", "anthropic": "ANTHROPIC_API_KEY"}
URLS: dict[Provider, str] = {"openai": "OPENAI_BASE_URL", "anthropic": "ANTHROPIC_BASE_URL"}
HOSTS: dict[Provider, str] = {"openai": "api.openai.com", "anthropic": "api.anthropic.com"}
HERE = ("localhost", "127.0.0.1", "::1")
"""Hosts of this machine, whose servers may need no key."""
NO_KEY = "none"
PART = 12
"""Characters of a key's beginning or end that are cut out too: servers show some of them."""


@dataclass(frozen=True)
class ModelEndpoint:
    """A model that can be asked. The key is in no text of it."""

    provider: Provider
    name: str
    base_url: str | None = None
    key: str = field(default="", repr=False)

    def __str__(self) -> str:
        return f"{self.provider}:{self.name}"

    @property
    def host(self) -> str:
        """Host and port that it is at."""
        return urlsplit(self.base_url).netloc if self.base_url else HOSTS[self.provider]

    @property
    def url(self) -> str:
        """Of its API."""
        return self.base_url or f"https://{self.host}{'/v1' if self.provider == 'openai' else ''}"

    def redacted(self, text: str) -> str:
        """A text without the key: servers echo it in errors."""
        if self.key in ("", NO_KEY):
            return text
        for secret in (self.key, quote(self.key, safe="")):
            text = text.replace(secret, "[key]")
        for part in (self.key[:PART], self.key[-PART:]):
            text = text.replace(part, "[key]") if len(self.key) > PART else text
        return text


def model_endpoint(spec: str) -> ModelEndpoint:
    """The endpoint of a spec. Over plain http no key goes to another machine.

    Raises InputError for anything else, for a key in it, and where no key is set."""
    provider, _, rest = spec.partition(":")
    name, _, url = rest.partition("@")
    if provider not in KEYS or not re.fullmatch(r"[\w./:+-]{1,120}", name, re.ASCII):
        raise InputError("--model", found=cut(repr(_without_secrets(spec))), accepted=ACCEPTED)
    known: Provider = "openai" if provider == "openai" else "anthropic"
    where = "--model" if url else URLS[known]
    url = url or os.environ.get(URLS[known], "").strip()
    if url:
        _require_url(url, where)
    here = bool(url) and (urlsplit(url).hostname or "") in HERE
    in_clear = bool(url) and urlsplit(url).scheme == "http" and not here
    key = "" if in_clear else os.environ.get(KEYS[known], "").strip()
    if not key and not here and not in_clear:
        raise InputError(f"--model {provider}:{name}", found="no key", accepted=f"the key in ${KEYS[known]}")
    if not key.isascii() or not key.isprintable():
        raise InputError(f"${KEYS[known]}", found="characters that no key has", accepted="a key of plain ASCII")
    return ModelEndpoint(provider=known, name=name, base_url=url or None, key=key or NO_KEY)


def _require_url(url: str, where: str) -> None:
    accepted = "an http or https URL without user, password, query and fragment, as https://host/v1"
    try:
        parts = urlsplit(url)
        bad = parts.scheme not in ("http", "https") or not parts.hostname or parts.port == 0
    except ValueError:
        raise InputError(where, found="no URL", accepted=accepted) from None
    if parts.username or parts.password or parts.query or parts.fragment or "@" in parts.netloc:
        raise InputError(where, found="a URL with more than host and path", accepted=accepted)
    if bad:
        raise InputError(where, found=cut(repr(_without_secrets(url))), accepted=accepted)


def _without_secrets(text: str) -> str:
    """A spec as it may be repeated: without users and queries of URLs, and what looks like a key."""
    text = re.sub(r"//[^/@]*@", "//[...]@", text)
    return re.sub(r"\?.*|\b(?:sk|key)-[\w-]+", "[...]", text)
