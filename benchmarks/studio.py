"""The studio in a real Chromium: from a photo to a film, seconds to every step, pictures of every page.

usage: python benchmarks/studio.py [FOLDER ...] [--data PATH] [--out FOLDER]
Without FOLDER: the example, and two frames of ``real`` from their photos and boxes around the given masks alone.
Needs the extras studio and browser, and Chromium. Exit codes: 0 all films were made in silence, 1 one was not.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from f3sr.io.images import open_image
from run import REPO

FRAMES = ("real/ycb_table_0", "real/ycb_table_1")
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WIDE, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
LOOSE = 3
"""By which boxes are wider than the given masks [px], on every side."""
PATIENCE_MS = 300_000
FRAMES_PER_SECOND = """async () => {
    const { view } = window.studio.STEPS.scene, canvas = document.getElementById("scene-view");
    const gl = canvas.getContext("webgl2");
    const pixel = new Uint8Array(4), start = performance.now();
    let count = 0;
    while (performance.now() - start < 3000) {
        canvas.dispatchEvent(new KeyboardEvent("keydown", { key: count % 40 < 20 ? "a" : "d" }));
        await new Promise((next) => requestAnimationFrame(next));
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel); // waits until it is drawn
        count += 1;
    }
    view.from("photo");
    return count / 3;
}"""


class Visit:
    """One project on the way from its beginning to a film."""

    def __init__(self, tab: Any, address: str, name: str, out: Path) -> None:
        self.tab, self.address, self.name, self.out = tab, address, name, out
        self.start, self.seconds = time.perf_counter(), dict[str, float]()

    def reached(self, step: str) -> None:
        """Note the time, and take a picture of the page in both widths."""
        self.seconds[step] = round(time.perf_counter() - self.start, 1)
        pause = time.perf_counter()
        for size, ending in ((WIDE, ""), (PHONE, "_phone")):
            self.tab.set_viewport_size(size)
            self.tab.wait_for_timeout(700)
            self.tab.screenshot(path=str(self.out / f"{self.name}_{step}{ending}.png"))
        self.tab.set_viewport_size(WIDE)
        self.start += time.perf_counter() - pause

    def made(self, folder: Path | None) -> dict[str, Any]:
        """The whole way; the row of the table."""
        tab = self.tab
        tab.goto(self.address)
        tab.wait_for_selector("h1")
        self.reached("home")
        if folder is None:
            tab.click("#example")
        else:
            self.outlined(folder)
        tab.wait_for_selector("#step-run:not([hidden])")
        tab.click("#run-start")
        tab.wait_for_selector("#run-next:not([hidden]), #run-state.bad", timeout=PATIENCE_MS)
        self.reached("make")
        tab.click("#run-next a")
        tab.wait_for_selector("#objects button")
        tab.click("#objects button >> nth=0")
        tab.wait_for_timeout(500)
        self.reached("scene")
        rate = tab.evaluate(FRAMES_PER_SECOND)
        tab.click("#steps a[href='#play']")
        tab.click("#suggestions button >> nth=0")
        tab.wait_for_selector("#understood:has-text('Understood')")
        tab.click("#play-start")
        tab.wait_for_selector(".rollout iframe, #play-state.bad", timeout=PATIENCE_MS)
        tab.wait_for_timeout(1500)
        self.reached("film")
        film = tab.frame_locator(".rollout iframe").locator("header p").last.inner_text()
        goal = tab.input_value("#goal")
        tab.click("#steps a[href='#take']")
        tab.wait_for_selector("#take-work:not([hidden])")
        self.reached("take")
        measures = tab.evaluate("window.studio.STEPS.scene.state.measures")
        row = {"name": self.name, "goal": goal, "verdict": film, "mIoU_visible": round(measures["mIoU_visible"], 3)}
        return {**row, "N_cross": measures["N_cross"], "frames_per_second": round(rate, 1), "seconds": self.seconds}

    def outlined(self, folder: Path) -> None:
        """Upload the photo, and box every object by hand."""
        tab = self.tab
        tab.set_input_files("#photo", str(next(iter(sorted(folder.glob("image.*"))))))
        canvas = tab.frame_locator("#outline-frame").locator("#canvas")
        canvas.wait_for()
        tab.wait_for_timeout(1000)
        frame = next(f for f in tab.frames if f.url.endswith("/outline/"))
        for label, corners in boxes(folder):
            places, at = (
                [frame.evaluate("(p) => page.view.toCanvas(p)", list(c)) for c in corners],
                canvas.bounding_box(),
            )
            (x0, y0), (x1, y1) = [(at["x"] + x, at["y"] + y) for x, y in places]
            tab.mouse.move(x0, y0)
            tab.mouse.down()
            tab.mouse.move(x1, y1, steps=4)
            tab.mouse.up()
            frame.locator("#objects li input").last.fill(label)
        frame.wait_for_selector("#save:not([disabled])")
        tab.wait_for_timeout(2500)
        self.reached("outline")
        frame.locator("#save").click()


def boxes(folder: Path) -> Iterator[tuple[str, tuple[tuple[int, int], tuple[int, int]]]]:
    """Label and corners of a box around every given mask."""
    for file in sorted((folder / "masks").glob("*.png")):
        mask = np.asarray(open_image(file).convert("L")) > 127
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        low = (max(0, int(columns[0]) - LOOSE), max(0, int(rows[0]) - LOOSE))
        high = (min(mask.shape[1], int(columns[-1]) + 1 + LOOSE), min(mask.shape[0], int(rows[-1]) + 1 + LOOSE))
        yield re.sub(r"^\d+_?", "", file.stem).replace("_", " "), (low, high)


@contextmanager
def served(workspace: Path) -> Iterator[str]:
    """The address of a studio in a process of its own."""
    command = [sys.executable, "-m", "f3sr", "studio", "--workspace", str(workspace), "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "studio")
    args = parser.parse_args()
    from playwright.sync_api import sync_playwright

    found = args.folders or [None, *(args.data / name for name in FRAMES)]
    shutil.rmtree(args.out, ignore_errors=True)
    args.out.mkdir(parents=True)
    silent = True
    with served(args.out / "workspace") as address, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        for folder in found:
            tab, said = browser.new_page(viewport=WIDE), list[str]()
            tab.on("console", lambda m, said=said: said.append(m.text) if m.type == "error" else None)
            tab.on("pageerror", lambda error, said=said: said.append(str(error)))
            row = Visit(tab, address, folder.name if folder else "example", args.out).made(folder)
            print(json.dumps(row | {"console": said}), flush=True)
            silent = silent and not said
            tab.close()
        browser.close()
    return 0 if silent else 1


if __name__ == "__main__":
    sys.exit(main())
