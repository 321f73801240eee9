"""A server for several users: the real command line over TLS, with tokens, quotas and metrics."""

import json
import os
import re
import signal
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from footlight.cli.exits import Exit
from tests.e2e.conftest import FOOTLIGHT, Command
from tests.server.api.certificates import Authority
from tests.server.farm.databases import a_server

# More than any test waits for.
LONG = ("--size", "32x32", "--spp", 1 << 20, "--threads", 1)
SHORT = ("--size", "32x32", "--spp", 2)


@dataclass
class House:
    """A server, as its owner and as its users reach it."""

    local: str
    remote: str
    authority: Path
    metrics: str
    room: Path
    images: Path
    run: Command
    tokens: dict[tuple[str, str], str] = field(default_factory=dict)

    def owner(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        """A command of whoever runs the server."""
        return self.run(*arguments, env=self._environment(self.local))

    def token(self, user: str, scope: str = "submit") -> str:
        """The secret of a token, made when it is first asked for."""
        if (user, scope) not in self.tokens:
            done = self.owner("token", "create", user, "--scope", scope)
            assert done.returncode == Exit.OK, done.stderr
            self.tokens[user, scope] = done.stdout.strip()
        return self.tokens[user, scope]

    def user(self, secret: str, *arguments: object) -> subprocess.CompletedProcess[str]:
        """A command of whoever has that token, from elsewhere."""
        return self.run(*arguments, env=self.environment(secret))

    def environment(self, secret: str) -> dict[str, str]:
        return self._environment(self.remote) | {"FOOTLIGHT_TOKEN": secret, "FOOTLIGHT_CA": str(self.authority)}

    @staticmethod
    def _environment(server: str) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("FOOTLIGHT_")}
        return kept | {"FOOTLIGHT_SERVER": server, "COLUMNS": "200"}


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, footlight: Command, room: Path) -> Iterator[House]:
    directory = tmp_path_factory.mktemp("ops")
    (directory / "images").mkdir()
    authority = Authority(directory)
    files = authority.sign("server")
    command = [FOOTLIGHT, "serve", "--data", directory / "data", "--quota-jobs", 2, "--drain-seconds", 0]
    command += ["--listen", f"unix:{directory}/socket", "--listen", "0.0.0.0:0", "--metrics", "127.0.0.1:0"]
    command += ["--tls-cert", files.certificate, "--tls-key", files.key]
    command += ["--root", room.parent, "--output-root", directory / "images"]
    log = directory / "log"
    with log.open("w") as stderr:
        process = subprocess.Popen([str(part) for part in command], stdout=subprocess.PIPE, stderr=stderr, text=True)
    assert process.stdout is not None
    try:
        addresses = [process.stdout.readline().split()[-1] for _ in range(2)]
        found = re.search(r"metrics at (\S+)", log.read_text())
        assert found is not None
        port = addresses[1].rpartition(":")[2]
        yield House(
            addresses[0], f"127.0.0.1:{port}", authority.certificate, found[1], room, directory / "images", footlight
        )
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        process.stdout.close()
    assert "Traceback" not in log.read_text()
    assert "footlight_" not in re.sub(r"footlight_(server|core|ops)", "", log.read_text())


def submit(run: Callable[..., subprocess.CompletedProcess[str]], house: House, *options: object) -> str:
    """The name of a new job of the room."""
    done = run("submit", house.room, "--json", *options)
    assert done.returncode == Exit.OK, done.stderr
    return str(json.loads(done.stdout)["job"]["name"])


def test_a_user_submits_from_elsewhere_and_fetches_the_images(house: House, tmp_path: Path) -> None:
    ada = house.token("ada")

    def as_ada(*arguments: object) -> subprocess.CompletedProcess[str]:
        return house.user(ada, *arguments)

    done = as_ada("submit", house.room, "--frames", "1-2", *SHORT, "--watch", "--json")
    assert done.returncode == Exit.OK, done.stderr
    listed = json.loads(as_ada("jobs", "--json").stdout)
    assert [(job["user"], job["state"]) for job in listed] == [("ada", "JOB_STATE_SUCCEEDED")]
    done = as_ada("fetch", listed[0]["name"], "-o", tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    fetched = sorted(tmp_path.rglob("*.exr"))
    assert [path.read_bytes()[:4] for path in fetched] == [b"v/1\x01"] * 2
    done = as_ada("render", house.room, "-o", tmp_path / "render.exr", *SHORT, "--frame", 1)
    assert done.returncode == Exit.OK, done.stderr
    assert (tmp_path / "render.exr").read_bytes() == fetched[0].read_bytes()


def test_nobody_gets_in_without_a_token_or_past_its_scope(house: House) -> None:
    reader = house.token("eve", "read")
    assert house.run("jobs", env=house.environment("")).returncode == Exit.DENIED
    assert house.user("footlight_" + "x" * 43, "jobs").returncode == Exit.DENIED
    assert house.user(reader, "jobs").returncode == Exit.OK
    for command in (("submit", house.room), ("token", "list"), ("token", "create", "eve", "--scope", "admin")):
        done = house.user(reader, *command)
        assert done.returncode == Exit.DENIED, (command, done.stderr)
        assert reader not in done.stderr


def test_what_is_anothers_is_left_alone(house: House) -> None:
    ada, bob, admin = house.token("ada"), house.token("bob"), house.token("root", "admin")
    job = submit(lambda *arguments: house.user(ada, *arguments), house, *SHORT, "--paused")
    for verb in ("pause", "resume", "cancel"):
        assert house.user(bob, verb, job).returncode == Exit.DENIED, verb
    assert house.user(bob, "job", job).returncode == Exit.OK
    assert house.user(admin, "cancel", job).returncode == Exit.OK


def test_a_quota_is_each_users_own(house: House) -> None:
    ada, bob = house.token("ada"), house.token("bob")

    def as_ada(*arguments: object) -> subprocess.CompletedProcess[str]:
        return house.user(ada, *arguments)

    jobs = [submit(as_ada, house, *SHORT, "--paused") for _ in range(2)]
    refused = as_ada("submit", house.room, *SHORT, "--paused")
    assert refused.returncode == Exit.LIMIT
    assert "2 are allowed" in refused.stderr
    jobs.append(submit(lambda *arguments: house.user(bob, *arguments), house, *SHORT, "--paused"))
    assert as_ada("cancel", jobs[0]).returncode == Exit.OK
    jobs.append(submit(as_ada, house, *SHORT, "--paused"))
    for job in jobs:
        house.owner("cancel", job)


def test_outside_the_roots_nothing_is_read_or_written(house: House, tmp_path: Path) -> None:
    ada = house.token("ada")
    stage = tmp_path / "stage.usda"
    stage.write_text("#usda 1.0\n")
    done = house.user(ada, "submit", stage)
    assert done.returncode == Exit.STAGE
    done = house.user(ada, "submit", house.room, "-o", tmp_path / "image.exr")
    assert done.returncode != Exit.OK
    assert "not below a directory images may go to" in done.stderr


def test_images_are_for_whoever_the_operator_shares_files_with(house: House) -> None:
    images = house.images
    job = submit(house.owner, house, *SHORT, "-o", images / "image.exr")
    assert house.owner("watch", job, "--json").returncode == Exit.OK
    mask = os.umask(0)
    os.umask(mask)
    assert (images / "image.exr").stat().st_mode & 0o777 == 0o666 & ~mask
    assert [path.name for path in images.iterdir()] == ["image.exr"]


def test_a_revoked_token_ends_the_watch_it_opened(house: House) -> None:
    ada = house.token("revoked-ada")
    job = submit(lambda *arguments: house.user(ada, *arguments), house, *LONG)
    watch = subprocess.Popen(
        [str(FOOTLIGHT), "watch", job, "--json"],
        env=house.environment(ada),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert watch.stdout is not None
    assert watch.stdout.readline()
    tokens = json.loads(house.owner("token", "list", "--json").stdout)
    name = next(token["name"] for token in tokens if token["user"] == "revoked-ada")
    assert house.owner("token", "revoke", name).returncode == Exit.OK
    before = time.monotonic()
    _, said = watch.communicate(timeout=20)
    assert watch.returncode == Exit.DENIED, said
    assert time.monotonic() - before < 5
    assert house.user(ada, "jobs").returncode == Exit.DENIED
    assert house.owner("cancel", job).returncode == Exit.OK


def test_the_owner_sees_it_in_the_metrics(house: House) -> None:
    text = urllib.request.urlopen(house.metrics, timeout=10).read().decode()
    assert re.search(
        r'footlight_calls_total\{code="UNAUTHENTICATED",method="/footlight.v1.JobService/\w+"\} [1-9]', text
    )
    assert 'footlight_attempts_total{exit_class="succeeded"}' in text


def test_postgresql_holds_the_queue_and_takes_one_server(footlight: Command, room: Path, tmp_path: Path) -> None:
    def start(name: str, url: str) -> subprocess.Popen[str]:
        listen = f"unix:{tmp_path}/{name}.socket"
        command = [FOOTLIGHT, "serve", "--listen", listen, "--data", tmp_path / name, "--database", url]
        return subprocess.Popen(
            [str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    with a_server() as postgres:
        url = postgres.new_database()
        first = start("first", url)
        assert first.stdout is not None
        try:
            address = first.stdout.readline().split()[-1]
            done = footlight("submit", room, "--frames", "1-2", *SHORT, "--watch", "--json", "--server", address)
            assert done.returncode == Exit.OK, done.stderr
            second = start("second", url)
            said = second.communicate(timeout=30)[1]
            assert second.returncode == Exit.USAGE
            assert said.splitlines()[-1].startswith("footlight-server: ")
            assert "Traceback" not in said
            assert len(postgres.execute("SELECT * FROM frame", url.split("@/")[1].split("?")[0])) == 2
        finally:
            first.terminate()
            assert first.wait(20) == 0
            first.communicate()
    assert not (tmp_path / "first" / "queue.db").exists()
