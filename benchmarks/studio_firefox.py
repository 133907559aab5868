"""The studio in Firefox, driven by WebDriver BiDi: the example from its masks to a film, and what the console said.

usage: python benchmarks/studio_firefox.py [--out FOLDER]
Needs the extras studio and browser, and Firefox. Exit codes: 0 a film was made in silence, 1 not.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import itertools
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from run import REPO
from studio import served

PORT = 9223
PATIENCE_S = 300.0


class Firefox:
    """One tab over a BiDi connection."""

    def __init__(self, connection: Any, out: Path) -> None:
        self.connection, self.out = connection, out
        self.numbers, self.waiting, self.said = itertools.count(1), dict[int, asyncio.Future[Any]](), list[str]()
        self.context = ""

    async def listen(self) -> None:
        """Answers to their commands; errors and warnings of the console are kept."""
        async for text in self.connection:
            told = json.loads(text)
            if told.get("id") in self.waiting:
                self.waiting.pop(told["id"]).set_result(told)
            elif told.get("method") == "log.entryAdded" and told["params"]["level"] in ("error", "warn"):
                self.said.append(str(told["params"].get("text")))

    async def command(self, method: str, **parameters: Any) -> Any:
        number, answer = next(self.numbers), asyncio.get_running_loop().create_future()
        self.waiting[number] = answer
        await self.connection.send(json.dumps({"id": number, "method": method, "params": parameters}))
        told = await asyncio.wait_for(answer, PATIENCE_S)
        assert told["type"] == "success", told
        return told["result"]

    async def open(self, address: str) -> str:
        """A tab of the address; name and version of the browser."""
        capabilities = (await self.command("session.new", capabilities={}))["capabilities"]
        await self.command("session.subscribe", events=["log.entryAdded"])
        self.context = (await self.command("browsingContext.create", type="tab"))["context"]
        await self.command("browsingContext.navigate", context=self.context, url=address, wait="complete")
        return f"{capabilities['browserName']} {capabilities['browserVersion']}"

    async def value(self, script: str) -> Any:
        target = {"context": self.context}
        told = await self.command("script.evaluate", expression=script, target=target, awaitPromise=True)
        assert told["type"] == "success", told
        return told["result"].get("value")

    async def until(self, condition: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not await self.value(condition):
            assert time.monotonic() < end, (condition, self.said)
            await asyncio.sleep(0.2)

    async def click(self, selector: str) -> None:
        await self.until(f"document.querySelector({json.dumps(selector)}) !== null")
        await self.value(f"document.querySelector({json.dumps(selector)}).click()")

    async def picture(self, name: str) -> None:
        told = await self.command("browsingContext.captureScreenshot", context=self.context)
        (self.out / f"firefox_{name}.png").write_bytes(base64.b64decode(told["data"]))


async def visited(address: str, out: Path) -> dict[str, Any]:
    """The example from its masks to a film, with an edit on the way."""
    from websockets.asyncio.client import connect

    async with connect(f"ws://127.0.0.1:{PORT}/session", max_size=None) as connection:
        firefox, start = Firefox(connection, out), time.perf_counter()
        listening = asyncio.create_task(firefox.listen())
        name = await firefox.open(address)
        await firefox.click("#example")
        await firefox.click("#step-run:not([hidden]) #run-start:not([disabled])")
        await firefox.until("document.querySelector('#run-next:not([hidden])') !== null")
        await firefox.click("#run-next a")
        await firefox.click("#objects button")
        await firefox.click("[aria-label='Move to the right']")
        await firefox.until("document.getElementById('edit-state').textContent.startsWith('At rest')")
        await firefox.picture("scene")
        await firefox.click("#undo:not([disabled])")
        await firefox.click("#steps a[href='#play']")
        await firefox.click("#suggestions button")
        await firefox.until("document.getElementById('understood').textContent.startsWith('Understood')")
        await firefox.click("#play-start")
        await firefox.until("document.querySelector('.rollout iframe') !== null")
        seconds = round(time.perf_counter() - start, 1)
        await asyncio.sleep(3)
        await firefox.picture("film")
        verdict = await firefox.value("document.querySelector('.rollout h3').textContent")
        listening.cancel()
        return {"browser": name, "verdict": verdict, "seconds": seconds, "console": firefox.said}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=REPO / "out" / "studio_firefox")
    args = parser.parse_args()
    program = shutil.which("firefox") or shutil.which("firefox-esr")
    if program is None:
        print("skipped: no Firefox on this machine")
        return 0
    shutil.rmtree(args.out, ignore_errors=True)
    (args.out / "profile").mkdir(parents=True)
    arguments = ["--headless", f"--remote-debugging-port={PORT}", "--profile", str(args.out / "profile"), "about:blank"]
    quiet = subprocess.DEVNULL
    with (
        served(args.out / "workspace") as address,
        subprocess.Popen([program, *arguments], stdout=quiet, stderr=quiet) as firefox,
    ):
        try:
            time.sleep(8)  # until it listens
            row = asyncio.run(visited(address, args.out))
        finally:
            firefox.terminate()
    print(json.dumps(row))
    return 1 if row["console"] or not row["verdict"].endswith("met") else 0


if __name__ == "__main__":
    sys.exit(main())
