"""What a worker may use."""

import subprocess
import sys

from footlight_server.workers.limits import worker_environment


def test_nothing_that_decides_what_code_runs_reaches_a_worker() -> None:
    surroundings = dict.fromkeys(
        ["PXR_PLUGINPATH_NAME", "PXR_AR_DEFAULT_SEARCH_PATH", "PYTHONPATH", "LD_PRELOAD", "TF_DEBUG"], "/evil"
    )
    environment = worker_environment({"PATH": "/bin", "OCIO": "/config.ocio", "USDC_USE_PREAD": "0", **surroundings})
    ours = {"USDC_USE_PREAD": "1", "OPENBLAS_NUM_THREADS": "1"}
    assert environment == {"PATH": "/bin", "OCIO": "/config.ocio", **ours}


def test_memory_is_limited_from_where_the_process_stands() -> None:
    program = (
        "from footlight_server.workers.limits import set_limits\n"
        "before = bytearray(200 << 20)\n"
        "set_limits(100 << 20, 0)\n"
        "fits = bytearray(50 << 20)\n"
        "try:\n"
        "    bytearray(100 << 20)\n"
        "except MemoryError:\n"
        "    print('refused')\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout == "refused\n"
