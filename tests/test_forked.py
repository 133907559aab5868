"""Forked processes are to their caller what new interpreters are: the same program says the same of itself in both."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import forked
from waiting import children, is_running, soon

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux only")
SAID = """
import json, os, resource, signal, sys, threading
handled = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE, signal.SIGXFSZ)
print(json.dumps({
    "arguments": sys.argv, "name": __name__, "folder": os.getcwd(), "path": sys.path[0], "words": dict(os.environ),
    "parent": os.getppid(), "group": os.getpgid(0) - os.getpid() and os.getpgid(0), "session": os.getsid(0),
    "descriptors": [k for k in range(64) if os.path.exists(f"/proc/self/fd/{k}")], "input": sys.stdin.read(),
    "handlers": [str(signal.getsignal(number)) for number in handled], "blocked": list(signal.pthread_sigmask(0, [])),
    "files": resource.getrlimit(resource.RLIMIT_FSIZE), "threads": threading.active_count(), "umask": os.umask(0),
}), flush=True)
print("heard", file=sys.stderr)
sys.exit(7)
"""


def both(*command: str, given: str = "", **more: Any) -> list[tuple[str, str, int]]:
    """What a new interpreter and a forked process say, and how they end."""
    found = list[tuple[str, str, int]]()
    for popen in (subprocess.Popen, forked.Popen):
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        process = popen([sys.executable, *command], text=True, **streams, **more)
        said, errors = process.communicate(given)
        found.append((said, errors, process.returncode))
    return found


@pytest.mark.parametrize("kind", ["code", "file", "module"])
@pytest.mark.parametrize("group", [None, 0])
def test_a_program_says_the_same_of_itself(kind: str, group: int | None, tmp_path: Path):
    (tmp_path / "program.py").write_text(SAID)
    command = {"code": ["-c", SAID], "file": [str(tmp_path / "program.py")], "module": ["-m", "program"]}[kind]
    ear, mouth = os.pipe()
    fresh, fork = both(
        *(*command, "a", "--b"),
        given="words\n",
        cwd=tmp_path,
        env={"LC_ALL": "C.UTF-8", "WORD": "ä"},
        process_group=group,
        pass_fds=[mouth],
        preexec_fn=partial(resource.setrlimit, resource.RLIMIT_FSIZE, (4000, 5000)),
    )
    os.close(ear), os.close(mouth)
    assert json.loads(fork[0]) == json.loads(fresh[0]) and fork[1:] == fresh[1:] == ("heard\n", 7)
    assert json.loads(fork[0])["parent"] == os.getpid() and mouth in json.loads(fork[0])["descriptors"]


@pytest.mark.parametrize(
    ("code", "ended"), [("1 / 0", 1), ("import os; os._exit(5)", 5), ("import os; os.abort()", -6)]
)
def test_it_ends_as_it_ends(code: str, ended: int):
    (_, fresh, code_fresh), (_, fork, code_fork) = both("-c", code)
    assert code_fresh == code_fork == ended and fresh.splitlines()[-1:] == fork.splitlines()[-1:]


def test_a_signal_ends_it_alone_and_its_caller_waits_for_it():
    """It is nobody else's child, and others that were started before go on."""
    sleeping = [sys.executable, "-c", "import time; time.sleep(60)"]
    one, other = forked.Popen(sleeping), forked.Popen(sleeping)
    assert {one.pid, other.pid} <= set(children(os.getpid()))
    one.send_signal(signal.SIGKILL)
    assert one.wait(10) == -signal.SIGKILL and not Path(f"/proc/{one.pid}").exists()
    assert other.poll() is None and is_running(other.pid)
    other.terminate()
    assert other.wait(10) == -signal.SIGTERM


def test_what_was_imported_is_there_and_nothing_was_compiled():
    code = "import sys, f3sr.runtime.kernels as k; print('mujoco' in sys.modules, k.kernel_folder.cache_info())"
    said = forked.run([sys.executable, "-c", code], check=True).stdout
    assert said.startswith("True CacheInfo(hits=0, misses=0")


def test_the_server_ends_with_its_caller():
    code = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import forked, waiting, os
forked.run([sys.executable, "-c", ""], check=True)
print(*waiting.children(os.getpid()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    (server,) = map(int, done.stdout.split())
    assert soon(lambda: not is_running(server), 10)
