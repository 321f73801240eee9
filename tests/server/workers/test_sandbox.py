"""A confined worker reaches what it runs on and what its task names, and nothing else, by either means."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from footlight.worker.v1 import worker_pb2
from footlight_server.workers import bubblewrap, sandbox
from footlight_server.workers.limits import worker_environment
from footlight_server.workers.runtime import runtime_paths
from tests.means import MEANS, lacking, require

# Confines itself as a worker does, then runs what it is given; what it raises is the answer.
PROGRAM = """
import ctypes, json, os, resource, signal, socket, sys, threading
from pathlib import Path
from footlight.worker.v1 import worker_pb2
from footlight_server.workers.confine import confine
confine(worker_pb2.Confinement.FromString(bytes.fromhex(sys.argv[1])))
try:
    answer = eval(sys.argv[2])
except OSError as error:
    answer = f"{type(error).__name__} {error.errno}"
print(json.dumps(answer))
"""


def run(means: str, expression: str, **paths: list[str]) -> subprocess.CompletedProcess[str]:
    """Evaluate an expression in a process that is confined by these means; `paths` as in Confinement."""
    confinement = worker_pb2.Confinement(**paths, outside=means == "bubblewrap")
    command = [sys.executable, "-P", "-c", PROGRAM, confinement.SerializeToString().hex() or "", expression]
    environment = worker_environment(os.environ)
    if means == "bubblewrap":
        program = bubblewrap.find_program()
        assert program is not None, "bubblewrap is among the packages that the tests need"
        command = bubblewrap.command(program, confinement, command)
        environment = bubblewrap.environment(os.environ)
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)


def answer(means: str, expression: str, **paths: list[str]) -> object:
    done = run(means, expression, **paths)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def refused(value: object) -> bool:
    """It failed as what is not there, or not allowed."""
    return isinstance(value, str) and value.split()[0] in {"PermissionError", "FileNotFoundError", "OSError"}


@pytest.fixture(params=MEANS)
def means(request: pytest.FixtureRequest) -> str:
    require(request.param)
    return str(request.param)


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    (tmp_path / "outside").mkdir()
    path = tmp_path / "outside" / "secret"
    path.write_text("TOPSECRET")
    return path


def test_only_what_is_named_is_read_and_written(means: str, tmp_path: Path, secret: Path) -> None:
    files, out = tmp_path / "files", tmp_path / "out"
    for folder in (files, out):
        folder.mkdir()
    (files / "stage").write_text("a stage")
    (files / "link").symlink_to(secret)
    paths = {"read_paths": [str(files)], "write_paths": [str(out)]}

    def tried(expression: str) -> object:
        return answer(means, expression, **paths)

    assert tried(f"Path('{files}/stage').read_text()") == "a stage"
    assert tried(f"Path('{out}/image').write_text('pixels')") == 6
    assert (out / "image").read_text() == "pixels"
    for path in (secret, files / "link", f"{files}/../outside/secret", "/etc/shadow", "/etc/passwd"):
        assert refused(tried(f"Path('{path}').read_bytes().decode()")), path
    environment = tried("Path('/proc/1/environ').read_bytes().decode()")
    assert refused(environment) or os.environ["HOME"] not in str(environment)
    assert refused(tried(f"os.listdir('{secret.parent}')"))
    assert refused(tried(f"Path('{files}/stage').write_text('changed')"))
    assert refused(tried(f"Path('{files}/new').write_text('new')"))
    assert refused(tried(f"Path('{files}/stage').chmod(0o777)"))
    assert refused(tried(f"os.truncate('{secret}', 0)"))
    assert refused(tried(f"os.utime('{files}/stage')"))
    assert refused(tried(f"os.rename('{files}/stage', '{out}/stage')"))
    assert refused(tried(f"os.unlink('{secret}')"))
    assert secret.read_text() == "TOPSECRET"
    assert (files / "stage").read_text() == "a stage"


def test_it_talks_to_nobody_and_starts_nothing(means: str) -> None:
    assert refused(answer(means, "socket.socket().fileno()"))
    assert refused(answer(means, "socket.socket(socket.AF_UNIX).fileno()"))
    assert refused(answer(means, "os.fork()"))
    assert refused(answer(means, f"os.kill({os.getpid()}, signal.SIGTERM)"))
    assert refused(answer(means, f"resource.prlimit({os.getpid()}, resource.RLIMIT_CORE, (0, 0))"))
    assert refused(answer(means, "os.setpriority(os.PRIO_USER, 0, 19)"))


@pytest.mark.parametrize(
    "expression",
    [
        "os.execv(sys.executable, [sys.executable])",
        "ctypes.CDLL(None).ptrace(0, 0, 0, 0)",
        "ctypes.CDLL(None).unshare(0x10000000)",
        "ctypes.CDLL(None).mount(b'none', b'/tmp', b'tmpfs', 0, 0)",
    ],
    ids=["exec", "ptrace", "unshare", "mount"],
)
def test_what_nothing_harmless_does_kills_it(means: str, expression: str) -> None:
    done = run(means, expression)
    # As a shell tells of it, or as the kernel does: SIGSYS.
    assert done.returncode in {128 + 31, -31}, (done.returncode, done.stdout, done.stderr)


def test_it_may_still_do_its_work(means: str) -> None:
    assert answer(means, "(lambda t: (t.start(), t.join(), t.is_alive()))(threading.Thread(target=int))")[-1] is False  # type: ignore[index]
    assert answer(means, "os.fstat(os.memfd_create('film')).st_size") == 0
    assert answer(means, "__import__('numpy').dot([1.0], [2.0]).item()") == 2.0
    assert answer(means, "os.kill(os.getpid(), 0)") is None
    assert answer(means, "len(__import__('pxr.Usd').__name__)") == 3


def test_limits_cannot_be_raised_again(means: str) -> None:
    raised = answer(means, "[resource.getrlimit(resource.RLIMIT_NOFILE)[i] for i in (0, 1)]")
    assert isinstance(raised, list)
    assert raised[0] == raised[1] <= 4096
    again = run(means, "resource.setrlimit(resource.RLIMIT_NOFILE, (8192, 8192))")
    assert "ValueError" in again.stderr or "PermissionError" in again.stdout, again


def test_a_process_with_more_threads_is_not_taken_for_confined() -> None:
    program = (
        "import threading, time\n"
        "from footlight.worker.v1 import worker_pb2\n"
        "from footlight_server.workers.confine import ConfinementError, confine\n"
        "threading.Thread(target=time.sleep, args=(60,), daemon=True).start()\n"
        "try:\n"
        "    confine(worker_pb2.Confinement())\n"
        "except ConfinementError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert "2 threads" in done.stdout


def test_what_it_runs_on_is_none_of_the_users_files() -> None:
    paths = runtime_paths()
    for folder in (Path("/"), Path("/home"), Path("/root"), Path("/etc"), Path("/var"), Path("/tmp"), Path.home()):
        assert folder not in paths
    tests = Path(__file__).resolve()
    assert not any(tests.is_relative_to(path) for path in paths)


def test_the_best_that_works_is_chosen_and_the_reason_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    works = {"bubblewrap": "user namespaces are off", "landlock": "the kernel is too old"}
    monkeypatch.setattr(sandbox, "_try", lambda name: works[name])
    none = sandbox.choose_sandbox.__wrapped__()
    assert none.name == "none"
    assert "user namespaces are off" in none.refusal
    assert "the kernel is too old" in none.refusal
    assert "--trust-scenes" in none.refusal
    works["landlock"] = ""
    landlock = sandbox.choose_sandbox.__wrapped__()
    assert (landlock.name, landlock.reason) == ("landlock", "bubblewrap: user namespaces are off")
    assert landlock.refusal == ""
    works["bubblewrap"] = ""
    assert sandbox.choose_sandbox.__wrapped__() == sandbox.Sandbox(sandbox.SandboxName.BUBBLEWRAP)


def test_what_works_here_is_chosen() -> None:
    works = [means for means in MEANS if not lacking(means)]
    assert sandbox.choose_sandbox().name == works[0]


def test_a_sandbox_that_does_not_hold_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    require(sandbox.SandboxName.BUBBLEWRAP)
    open_wide = lambda program, confinement, inner: [program, "--dev-bind", "/", "/", "--", *inner]  # noqa: ARG005, E731
    monkeypatch.setattr(bubblewrap, "command", open_wide)
    assert "files" in sandbox._try(sandbox.SandboxName.BUBBLEWRAP)


def test_where_bubblewrap_fails_its_words_are_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    require(sandbox.SandboxName.BUBBLEWRAP)
    broken = lambda program, confinement, inner: [program, "--ro-bind", "/no/such", "/", "--", *inner]  # noqa: ARG005, E731
    monkeypatch.setattr(bubblewrap, "command", broken)
    assert "/no/such" in sandbox._try(sandbox.SandboxName.BUBBLEWRAP)
