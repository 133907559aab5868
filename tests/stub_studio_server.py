"""A server of the studio without pages, to be killed: it has a workspace's queue, asks for a job and waits."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from f3sr.studio.job_queue import JobQueue
from f3sr.studio.workspace import Workspace


def main(folder: Path, *goals: str) -> None:
    workspace = Workspace(folder)
    queue = JobQueue(workspace, worker="stub_studio_work")
    for goal in goals:
        queue.submit(workspace.listed()[0], "play", {"goal": goal})
    print("ready", flush=True)
    time.sleep(60)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
