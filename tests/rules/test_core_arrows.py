"""The include arrows of the core: a folder includes only what stands left of it."""

from tests.rules.sources import ROOT, files, includes, name

# folder -> folders it may include; math stands under everything.
ARROWS = {
    "math": set(),
    "bsdf": {"math"},
    "light": {"math"},
    "subdiv": {"math"},
    "film": {"math"},
    "scene": {"math", "light", "bsdf"},
    "material": {"math", "bsdf", "scene"},
    "accel": {"math", "light", "scene"},
    "pipeline": {"math", "light", "bsdf", "scene", "material", "accel", "film"},
    "python": {"math", "light", "bsdf", "scene", "material", "accel", "film", "pipeline", "subdiv"},
}
# third party -> the one folder that may include it.
GATES = {"embree3/": "accel", "nanobind/": "python", "Python.h": "python", "opensubdiv/": "subdiv"}


def folder(path_name: str) -> str:
    return path_name.split("/")[1]


def test_every_folder_of_the_core_has_its_place() -> None:
    found = {folder(name(path)) for path in files("core", ".h", ".cpp")}
    assert found <= set(ARROWS), f"say in ARROWS what {sorted(found - set(ARROWS))} may include"


def test_a_folder_includes_only_along_the_arrows() -> None:
    own = {path.name for path in (ROOT / "core").iterdir() if path.is_dir()}
    wrong = [
        f"{name(path)} includes {included}"
        for path in files("core", ".h", ".cpp")
        for included in includes(path)
        if (target := included.split("/")[0]) in own
        and target != (source := folder(name(path)))
        and target not in ARROWS[source]
    ]
    assert wrong == []


def test_each_third_party_enters_through_one_folder() -> None:
    wrong = [
        f"{name(path)} includes {included}"
        for path in files("core", ".h", ".cpp")
        for included in includes(path)
        for prefix, gate in GATES.items()
        if included.startswith(prefix) and folder(name(path)) != gate
    ]
    assert wrong == []
