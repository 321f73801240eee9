"""The import arrows of Python: client <- server, pxr and the core only in the worker's child process."""

import subprocess
import sys

from tests.rules.sources import files, imports, name

# What runs in the worker's child process only.
CHILD = ("workers/child.py", "workers/render_task.py", "workers/versions.py")


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
    assert offenders("client/footlight", {"footlight_server", "footlight_core", "pxr", "OpenImageIO"}) == []


def test_only_the_translator_imports_pxr() -> None:
    assert offenders("server/footlight_server", {"pxr"}, ("server/footlight_server/usd/",)) == []


def test_only_the_worker_and_the_translator_import_the_core() -> None:
    allowed = tuple(f"server/footlight_server/{part}" for part in ("usd/", *CHILD))
    assert offenders("server/footlight_server", {"footlight_core"}, allowed) == []


def test_only_images_imports_image_libraries() -> None:
    allowed = ("server/footlight_server/images/",)
    assert offenders("server/footlight_server", {"OpenImageIO", "PyOpenColorIO"}, allowed) == []


def test_only_the_service_knows_grpc() -> None:
    below = ("sessions", "usd", "images", "workers")
    wrong = [line for folder in below for line in offenders(f"server/footlight_server/{folder}", {"grpc"})]
    assert wrong == []


def test_state_machines_know_no_clock_no_io_and_no_protobuf() -> None:
    forbidden = {"asyncio", "time", "datetime", "socket", "subprocess", "os", "google", "footlight.v1"}
    assert offenders("server/footlight_server/sessions/machine.py", forbidden) == []
    assert [line for line in offenders("server/footlight_server/sessions", forbidden) if "machine.py" in line] == []


def test_the_server_process_loads_neither_pxr_nor_the_core() -> None:
    program = (
        "import sys, footlight_server.__main__;"
        "print(sorted({'pxr', 'footlight_core', 'OpenImageIO', 'PyOpenColorIO'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.strip() == "[]"


def test_the_client_loads_neither_pxr_nor_the_core() -> None:
    program = (
        "import sys, footlight;"
        "print(sorted({'pxr', 'footlight_core', 'footlight_server', 'OpenImageIO', 'typer'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.strip() == "[]"
