"""The import arrows of Python: client <- server, pxr and the core only in the worker's child process."""

import subprocess
import sys

from tests.rules.sources import files, imports, name

# What runs in the worker's child process only.
CHILD = tuple(
    f"workers/{name_}.py" for name_ in ("child", "merge_task", "options", "placed_scene", "render_task", "versions")
)


def offenders(folder: str, forbidden: set[str], allowed_in: tuple[str, ...] = ()) -> list[str]:
    """Files below the folder that import a forbidden module, except under the allowed paths."""
    return [
        f"{name(path)} imports {module}"
        for path in files(folder, ".py")
        if not name(path).startswith(allowed_in or ("\0",))
        for module in imports(path)
        if any(module == name_ or module.startswith(f"{name_}.") for name_ in forbidden)
    ]


def test_the_client_imports_neither_server_nor_core_nor_pxr() -> None:
    assert offenders("client/footlight", {"footlight_server", "footlight_core", "OpenImageIO"}) == []
    # Which files a stage refers to, only USD knows; whoever does not upload does not need it.
    assert offenders("client/footlight", {"pxr"}, ("client/footlight/upload/collect.py",)) == []


def test_the_steps_of_an_upload_know_no_connection_and_no_clock() -> None:
    shell = ("client/footlight/upload/blobs.py",)
    assert offenders("client/footlight/upload", {"grpc", "asyncio", "time"}, shell) == []


def test_only_the_translator_imports_pxr() -> None:
    assert offenders("server/footlight_server", {"pxr"}, ("server/footlight_server/usd/",)) == []


def test_only_the_worker_and_the_translator_import_the_core() -> None:
    allowed = tuple(f"server/footlight_server/{part}" for part in ("usd/", *CHILD))
    assert offenders("server/footlight_server", {"footlight_core"}, allowed) == []


def test_only_images_imports_image_libraries() -> None:
    allowed = ("server/footlight_server/images/",)
    assert offenders("server/footlight_server", {"OpenImageIO", "PyOpenColorIO"}, allowed) == []


def test_only_the_sandbox_asks_the_kernel_to_confine() -> None:
    """Each library in one file, and never in the server's own process: what they do cannot be undone."""
    for library, file in (("py_landlock", "confine.py"), ("pyseccomp", "syscalls.py")):
        assert offenders("server/footlight_server", {library}, (f"server/footlight_server/workers/{file}",)) == []
    confining = {f"footlight_server.workers.{module}" for module in ("confine", "syscalls")}
    inside = tuple(f"server/footlight_server/workers/{file}.py" for file in ("child", "trial", "confine"))
    assert offenders("server/footlight_server", confining, inside) == []


def test_only_the_service_knows_grpc() -> None:
    below = ("blobs", "farm", "sessions", "usd", "images", "workers")
    wrong = [line for folder in below for line in offenders(f"server/footlight_server/{folder}", {"grpc"})]
    assert wrong == []


def test_state_machines_know_no_clock_no_io_and_no_protobuf() -> None:
    forbidden = {"asyncio", "time", "datetime", "socket", "subprocess", "os", "google", "footlight.v1"}
    assert offenders("server/footlight_server/sessions/machine.py", forbidden) == []
    assert [line for line in offenders("server/footlight_server/sessions", forbidden) if "machine.py" in line] == []
    pure = {f"server/footlight_server/farm/{name}.py" for name in ("transitions", "blocklist")}
    assert [line for line in offenders("server/footlight_server/farm", forbidden) if line.split()[0] in pure] == []


def test_only_the_queue_knows_sql() -> None:
    allowed = ("server/footlight_server/farm/queue.py", "server/footlight_server/farm/sql/")
    assert offenders("server/footlight_server", {"sqlalchemy", "alembic", "psycopg", "sqlite3"}, allowed) == []


def test_only_one_file_tells_prometheus() -> None:
    assert offenders("server/footlight_server", {"prometheus_client"}, ("server/footlight_server/metrics.py",)) == []


def test_a_private_server_loads_neither_a_database_nor_what_it_has_no_use_for() -> None:
    """Somebody waits for it to start: `footlight render` without a server."""
    heavy = {"sqlalchemy", "alembic", "prometheus_client", "ray", "fileseq", "pythonjsonlogger", "psycopg"}
    ours = {"footlight.v1.job_pb2", "footlight_server.farm.queue", "footlight_server.blobs.store"}
    program = f"import sys, footlight_server.__main__; print(sorted({heavy | ours!r} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.strip() == "[]"


def test_the_server_process_loads_neither_pxr_nor_the_core() -> None:
    program = (
        "import sys, footlight_server.__main__;"
        "print(sorted({'pxr', 'footlight_core', 'OpenImageIO', 'PyOpenColorIO'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.strip() == "[]"


def test_importing_the_client_costs_next_to_nothing() -> None:
    heavy = {
        "pxr",
        "footlight_core",
        "footlight_server",
        "OpenImageIO",
        "typer",
        "rich",
        "grpc",
        "numpy",
        "google.protobuf",
    }
    program = f"import sys, footlight; print(sorted({heavy!r} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.strip() == "[]"
