"""`make mutants`: builds every wrong renderer of mutants.py and shows that the laws reject it; exit code 1 if not.

Usage: python tests/mutants/run.py [--jobs N] [NAME ...]
"""

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.mutants.mutants import MUTANTS, Mutant  # noqa: E402

LONGEST_TEST_RUN = 900.0  # [s]; a renderer that hangs is rejected too


def level() -> str:
    """The best x86-64 level that this machine runs and the core is built for: v4 or v3."""
    loader = subprocess.run(["/lib64/ld-linux-x86-64.so.2", "--help"], capture_output=True, text=True, check=True)
    return "v4" if "x86-64-v4 (supported" in loader.stdout else "v3"


@dataclass(frozen=True, slots=True)
class Tests:
    """What a run of pytest said."""

    code: int  # of the process: 0 all passed, 1 some failed, below 0 a signal
    output: str

    @property
    def failed(self) -> tuple[str, ...]:
        """The node ids that failed."""
        lines = (line for line in self.output.splitlines() if line.startswith("FAILED "))
        return tuple(line.removeprefix("FAILED ").split(" - ")[0] for line in lines)


class Workshop:
    """A copy of the sources in a folder of its own, and the renderers built from it."""

    def __init__(self, folder: Path, jobs: int) -> None:
        self.sources, self.build_folder, self.modules = folder / "sources", folder / "build", folder / "modules"
        self.module, self.jobs = f"_core_{level()}", jobs
        self.sources.mkdir()
        self.modules.mkdir()
        for name in ("core", "tests"):
            shutil.copytree(ROOT / name, self.sources / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
        for name in ("CMakeLists.txt", "pyproject.toml"):
            shutil.copy(ROOT / name, self.sources)
        options = (f"-DFOOTLIGHT_ISAS={level()}", "-DFOOTLIGHT_TESTS=OFF", f"-DPython_EXECUTABLE={sys.executable}")
        command = ("cmake", "-S", self.sources, "-B", self.build_folder, "-G", "Ninja", *options)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    def build(self, name: str) -> Path:
        """Build what the sources say, as a package of that name's folder; CalledProcessError if that fails."""
        command = ("cmake", "--build", self.build_folder, "--target", self.module, "--parallel", str(self.jobs))
        subprocess.run(command, check=True, capture_output=True, text=True)
        half_done, done = self.modules / f"{name}.part", self.modules / name
        package = half_done / "footlight_core"
        shutil.copytree(self.sources / "core/python/footlight_core", package)
        for library in self.build_folder.glob(f"{self.module}.*.so"):
            shutil.copy(library, package)
        half_done.rename(done)
        return done

    def test(self, module: Path, tests: Iterable[str]) -> Tests:
        """Run tests against a build."""
        # Without site, which would put an editable footlight_core before this one.
        command = (sys.executable, "-S", "-m", "pytest", "-q", "--tb=no", "-p", "no:cacheprovider", *tests)
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(module), sysconfig.get_path("purelib")])}
        environment.pop("FOOTLIGHT_INSTRUCTION_SET", None)
        ran = subprocess.run(
            command,
            cwd=self.sources,
            env=environment,
            check=False,
            capture_output=True,
            text=True,
            timeout=LONGEST_TEST_RUN,
        )
        return Tests(ran.returncode, ran.stdout + ran.stderr)

    def check_unchanged(self, tests: Iterable[str]) -> None:
        """The tests pass on the renderer as it is: they reject mutants for what these change."""
        try:
            result = self.test(self.build("unchanged"), tests)
        except subprocess.CalledProcessError as error:
            sys.exit(f"the unchanged renderer does not build:\n{error.stdout}")
        if result.code != 0:
            sys.exit(f"the unchanged renderer is rejected:\n{result.output}")

    def verdict(self, mutant: Mutant) -> tuple[bool, str]:
        """Whether the mutant is rejected by each of its tests, and what is to be said about it."""
        file = self.sources / "core" / mutant.file
        original = file.read_text()
        file.write_text(mutant.applied_to(original))
        try:
            result = self.test(self.build(mutant.name.replace(" ", "_")), mutant.tests)
        except subprocess.CalledProcessError as error:
            return False, f"DOES NOT BUILD\n{error.stdout}"
        except subprocess.TimeoutExpired:
            return True, "killed by never ending"
        finally:
            file.write_text(original)
        if result.code < 0:
            return True, f"killed by signal {-result.code}"
        if result.code > 1:
            return False, f"TESTS DO NOT RUN\n{result.output}"
        passed = [test for test in mutant.tests if test not in result.failed]
        if passed:
            return False, f"SURVIVED {' '.join(passed)}"
        return True, "killed by " + ", ".join(test.split("::")[1] for test in mutant.tests)


def chosen(names: list[str]) -> tuple[Mutant, ...]:
    """The mutants of these names, all without any."""
    unknown = set(names) - {mutant.name for mutant in MUTANTS}
    if unknown:
        sys.exit(f"no mutant {', '.join(sorted(unknown))}; there are: {', '.join(m.name for m in MUTANTS)}")
    return tuple(mutant for mutant in MUTANTS if not names or mutant.name in names)


def main() -> None:
    """Try the mutants named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of mutants in mutants.py")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="compilers at a time")
    arguments = parser.parse_args()
    mutants = chosen(arguments.names)
    alive = []
    with tempfile.TemporaryDirectory(prefix="footlight-mutants-") as folder:
        workshop = Workshop(Path(folder), arguments.jobs)
        begin = time.monotonic()
        workshop.check_unchanged(sorted({test for mutant in mutants for test in mutant.tests}))
        print(f"{'mutant':60} {'s':>4}  verdict")
        print(f"{'(none)':60} {time.monotonic() - begin:4.0f}  passes all {len(mutants)} mutants' tests", flush=True)
        for mutant in mutants:
            begin = time.monotonic()
            killed, text = workshop.verdict(mutant)
            if not killed:
                alive.append(mutant.name)
            print(f"{mutant.name:60} {time.monotonic() - begin:4.0f}  {text}", flush=True)
    print(f"{len(mutants) - len(alive)} of {len(mutants)} rejected")
    if alive:
        sys.exit(f"not rejected: {', '.join(alive)}")


if __name__ == "__main__":
    main()
