"""A server's scratch folder goes with it; one that was killed leaves it to the next."""

import signal
import subprocess
import sys
from pathlib import Path

from footlight_server.scratch import scratch_folder, sweep

HOLDER = (
    "import sys, time\n"
    "from pathlib import Path\n"
    "from footlight_server.scratch import scratch_folder\n"
    "with scratch_folder(Path(sys.argv[1])) as folder:\n"
    "    (folder / 'film').write_bytes(b'pixels')\n"
    "    print(folder, flush=True)\n"
    "    time.sleep(60)\n"
)


def test_it_is_ours_alone_and_gone_in_the_end(tmp_path: Path) -> None:
    with scratch_folder(tmp_path) as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "image.exr").write_bytes(b"pixels")
        sweep(tmp_path)
        assert (folder / "image.exr").exists()
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_server_leaves_is_swept_and_what_a_living_one_has_is_not(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", HOLDER, tmp_path], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        folder = Path(process.stdout.readline().strip())
        with scratch_folder(tmp_path):
            assert (folder / "film").exists()
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        assert (folder / "film").exists()
        with scratch_folder(tmp_path) as ours:
            assert list(tmp_path.iterdir()) == [ours]
    finally:
        process.kill()
        process.wait(10)
        if process.stdout is not None:
            process.stdout.close()


def test_nothing_else_is_swept(tmp_path: Path) -> None:
    others = tmp_path / "precious"
    others.mkdir()
    (others / "lock").touch()
    (tmp_path / "footlight-scratch-link").symlink_to(others)
    (tmp_path / "footlight-scratch-just-made").mkdir()
    linked = tmp_path / "footlight-scratch-linked-lock"
    linked.mkdir()
    (linked / "lock").symlink_to(others / "lock")
    before = sorted(tmp_path.iterdir())
    sweep(tmp_path)
    assert sorted(tmp_path.iterdir()) == before
    assert (others / "lock").exists()
