"""Stages that mean harm, made as files in a folder: they reach outside, or are too much for a parser or a machine."""

import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Usd, UsdGeom

# What the files outside hold, and nothing that comes back may.
SECRET = "TOPSECRET"
# A stage that renders shows this and no more.
GOOD = 'def Cube "good" {\n}\n'

# Writes the files of a stage into a folder; the second folder is outside and holds secrets. The root layer's name.
Make = Callable[[Path, Path], str]


@dataclass(frozen=True, slots=True)
class End:
    """How a render ends.

    Attributes:
        reason: of the failure, as the protocol has it without its prefix; empty: it renders without the outside data.
        says: what the message says, or what the report does.
    """

    reason: str
    says: str


@dataclass(frozen=True, slots=True)
class Hostile:
    """A stage, its end if it is uploaded, and if it lies below a root of a server that trusts it. None: not tried."""

    make: Make
    uploaded: End | None
    trusted: End | None


def outside(folder: Path) -> Path:
    """Files that nobody shall get at: a stage, a broken one, a clip, a picture, a text."""
    folder.mkdir()
    mesh = "int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n"
    points = "[(7, 7, 7), (1, 0, 0), (0, 1, 0)]"
    stages = {
        "secret": f'(\n defaultPrim = "{SECRET}"\n)\ndef Mesh "{SECRET}" {{\n {mesh} point3f[] points = {points}\n}}\n',
        "broken": f"{SECRET} = 5\n",
        "clip": f'over "m" {{\n point3f[] points.timeSamples = {{\n  0: {points}\n }}\n}}\n',
    }
    for name, text in stages.items():
        (folder / f"{name}.usda").write_text("#usda 1.0\n" + text)
    (folder / "secret.png").write_bytes(picture(2, 1))
    (folder / "secret.txt").write_text(f"{SECRET}\n")
    return folder


def picture(width: int, height: int) -> bytes:
    """A PNG of that size, with as many texels as fit into a hundred rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = (b"\0" + b"\x80" * width) * min(height, 100)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def _text(text: str, **others: str) -> Make:
    """A root layer of this text, others beside it; {outside} stands for the folder outside, {up} for the way there."""

    def make(folder: Path, away: Path) -> str:
        for name, content in {"stage": text, **others}.items():
            filled = content.replace("{outside}", str(away)).replace("{up}", f"../../{away.name}")
            (folder / f"{name}.usda").write_text("#usda 1.0\n" + filled)
        return "stage.usda"

    return make


def _reference(asset: str) -> str:
    return f'def "reference" (\n references = @{asset}@\n) {{\n}}\n{GOOD}'


def _texture(asset: str) -> Make:
    return _text(f'def DomeLight "dome" {{\n asset inputs:texture:file = @{asset}@\n}}\n{GOOD}')


def _mesh(counts: str = "3", indices: str = "0, 1, 2", first: str = "0") -> Make:
    return _text(
        f'def Mesh "bad" {{\n int[] faceVertexCounts = [{counts}]\n int[] faceVertexIndices = [{indices}]\n'
        f" point3f[] points = [({first}, 0, 0), (1, 0, 0), (0, 1, 0)]\n}}\n{GOOD}"
    )


def _link(folder: Path, away: Path) -> str:
    (folder / "link.usda").symlink_to(away / "secret.usda")
    return _text(_reference("./link.usda"))(folder, away)


def _zipped(path: Path, name: str, text: str) -> None:
    """USD's own packer would follow references."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as package:
        package.writestr(name, "#usda 1.0\n" + text)


def _package(folder: Path, away: Path) -> str:
    _zipped(folder / "stage.usdz", "inner.usda", _reference(str(away / "secret.usda")))
    return "stage.usdz"


def _lying_package(folder: Path, _: Path) -> str:
    """The directory at its end names a text, the header of its file a layer; and that one nests too deep."""
    path = folder / "stage.usdz"
    _zipped(path, "m.usda", "[" * 2_000_000)
    data = path.read_bytes()
    at = data.rindex(b"m.usda")
    path.write_bytes(data[:at] + b"m.text" + data[at + 6 :])
    return path.name


def _crate(folder: Path) -> Path:
    path = folder / "stage.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreatePointsAttr([(i % 7, i % 5, i % 3) for i in range(5000)])
    stage.Save()
    return path


def _cut_crate(folder: Path, _: Path) -> str:
    path = _crate(folder)
    path.write_bytes(path.read_bytes()[:-300])
    return path.name


def _noisy_crate(folder: Path, _: Path) -> str:
    path = _crate(folder)
    data = bytearray(path.read_bytes())
    for at in range(100, len(data), 97):
        data[at] ^= 0xFF
    path.write_bytes(data)
    return path.name


def _crate_that_names_text(folder: Path, _: Path) -> str:
    (folder / "deep.usda").write_text('#usda 1.0\ndef "a" ' + _DEEP)
    path = folder / "stage.usdc"
    layer = Sdf.Layer.CreateNew(str(path))  # not a stage, which would read the other file
    Sdf.PrimSpec(layer, "a", Sdf.SpecifierDef).referenceList.Prepend(Sdf.Reference("./deep.usda"))
    layer.Save()
    return path.name


def _bomb(levels: int, more: str = "") -> Make:
    """10^levels prims in a few kilobytes."""
    text = 'def Xform "L0" {\n def Sphere "s" {\n }\n}\n'
    for level in range(1, levels + 1):
        text += f'def Xform "L{level}" {{\n'
        for child in range(10):
            text += f' def Xform "c{child}" (\n{more} references = </L{level - 1}>\n) {{\n }}\n'
        text += "}\n"
    return _text(text)


def _huge_picture(folder: Path, away: Path) -> str:
    (folder / "sky.png").write_bytes(picture(60_000, 60_000))
    return _texture("./sky.png")(folder, away)


def _pictures(folder: Path, away: Path) -> str:
    (folder / "sky.png").write_bytes(picture(40, 30))
    domes = "".join(f'def DomeLight "d{i}" {{\n asset inputs:texture:file = @./sky.png@\n}}\n' for i in range(20))
    return _text(domes + GOOD)(folder, away)


def _points(count: int) -> Make:
    points = ", ".join(["(0, 0, 0)"] * count)
    return _text(
        f'def Mesh "many" {{\n int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n'
        f' uniform token subdivisionScheme = "none"\n point3f[] points = [{points}]\n}}\n'
    )


_CLIPS = (
    'def Mesh "m" (\n clips = {\n  dictionary default = {\n   asset[] assetPaths = [@{up}/clip.usda@]\n'
    '   string primPath = "/m"\n   double2[] active = [(0, 0)]\n   double2[] times = [(0, 0), (1, 1)]\n'
    "   asset manifestAssetPath = @./manifest.usda@\n  }\n }\n) {\n int[] faceVertexCounts = [3]\n"
    f" int[] faceVertexIndices = [0, 1, 2]\n point3f[] points\n}}\n{GOOD}"
)
# Each layer's own words are harmless; together they lead outside (see Sdf.VariableExpression).
_EXPRESSION = (
    '(\n expressionVariables = {\n  string WHERE = "{up}"\n }\n)\n'
    f'def "reference" (\n references = @./inner.usda@</a>\n) {{\n}}\n{GOOD}'
)
_EXPRESSION_INNER = (
    '(\n expressionVariables = {\n  string WHERE = "."\n }\n)\n'
    'def "a" (\n references = @`"${WHERE}/secret.usda"`@\n) {\n}\n'
)
_DEEP = "{ float[] x = " + "[" * 2_000_000
_OUTSIDE = End("STAGE_UNREADABLE", "outside the directories")
_NESTS = End("STAGE_UNREADABLE", "brackets nest")
_BROKEN = End("STAGE_UNREADABLE", "stage.usdc")
_UNFOLDS = End("SCENE", "unfolds to about")
_MANY_INSTANCES = End("SCENE", "instances, allowed are")


def _either(make: Make, reason: str, says: str) -> Hostile:
    return Hostile(make, End(reason, says), End(reason, says))


def _leads_out(make: Make, says: str) -> Hostile:
    """What it names is a stage: not there for a confined worker; there for one that is not, and then refused."""
    return Hostile(make, End("", says), _OUTSIDE)


# What reaches outside, by name.
ESCAPES: Mapping[str, Hostile] = {
    "reference up": _leads_out(_text(_reference("{up}/secret.usda")), "secret.usda"),
    "reference absolute": _leads_out(_text(_reference("{outside}/secret.usda")), "secret.usda"),
    "reference to what does not parse": _either(_text(_reference("{up}/broken.usda")), "", "broken.usda"),
    "reference to a text": _either(_text(_reference("{up}/secret.txt")), "", "secret.txt"),
    "reference to /etc/shadow": _either(_text(_reference("/etc/shadow")), "", "/etc/shadow"),
    "reference to a device": _either(_text(_reference("/dev/zero")), "", "/dev/zero"),
    # A bundle holds no links.
    "reference by a link": Hostile(_link, None, _OUTSIDE),
    "payload up": _leads_out(_text(_reference("{up}/secret.usda").replace("references", "payload")), "secret.usda"),
    "sublayer up": _leads_out(_text(f"(\n subLayers = [@{{up}}/secret.usda@]\n)\n{GOOD}"), "secret.usda"),
    "nested layer": _leads_out(
        _text(_reference("./inner.usda"), inner='(\n defaultPrim = "reference"\n)\n' + _reference("{up}/secret.usda")),
        "secret.usda",
    ),
    "expression": _leads_out(_text(_EXPRESSION, inner=_EXPRESSION_INNER), "secret.usda"),
    "clips": _leads_out(_text(_CLIPS, manifest='over "m" {\n point3f[] points\n}\n'), "/m"),
    "package": _leads_out(_package, "secret.usda"),
    "texture up": _either(_texture("{up}/secret.png"), "", "secret.png"),
    "texture /etc/shadow": _either(_texture("/etc/shadow"), "", "/etc/shadow"),
    "texture /dev/zero": _either(_texture("/dev/zero"), "", "/dev/zero"),
    "texture of the environment": _either(_texture("/proc/self/environ"), "", "/proc/self/environ"),
}
# The same for what is too much, or makes no sense. Limits as in LIMITS, which hold for uploads.
BURDENS: Mapping[str, Hostile] = {
    "brackets": Hostile(_text(f'def "a" {_DEEP}'), _NESTS, _NESTS),
    "parentheses": Hostile(_text(f'def "a" {_DEEP}'.replace("[", "(")), _NESTS, _NESTS),
    "dictionaries": Hostile(_text("(\n customLayerData = {\n" + "dictionary a = {\n" * 100_000), _NESTS, _NESTS),
    "lying package": Hostile(_lying_package, _NESTS, _NESTS),
    # Where stages are trusted nobody looks, and the parser dies: in the worker, which is there for that.
    "brackets behind a crate file": Hostile(_crate_that_names_text, _NESTS, End("CRASHED", "crashed (SIGSEGV)")),
    "cut crate file": Hostile(_cut_crate, _BROKEN, _BROKEN),
    "noisy crate file": Hostile(_noisy_crate, _BROKEN, _BROKEN),
    "bomb of 10^6": Hostile(_bomb(6), _UNFOLDS, None),
    "bomb of 10^9": Hostile(_bomb(9), _UNFOLDS, None),
    "bomb of 10^9 instances": Hostile(_bomb(9, " instanceable = true\n"), _MANY_INSTANCES, _MANY_INSTANCES),
    "too many points": Hostile(_points(11_000), End("SCENE", "/many: with it the stage has 11000 points"), None),
    "too large a picture": _either(_huge_picture, "", "sky.png: cannot be read"),
    "too many texels": Hostile(_pictures, End("SCENE", "texels, allowed are"), None),
    "points that are no numbers": _either(_mesh(first="nan"), "", "/bad"),
    "infinite points": _either(_mesh(first="inf"), "", "/bad"),
    "negative count": _either(_mesh(counts="-3"), "", "/bad"),
    "index out of range": _either(_mesh(indices="0, 1, 2147483647"), "", "/bad"),
    "negative index": _either(_mesh(indices="0, 1, -2147483648"), "", "/bad"),
}
# Of the server, so that what is too much stays small here.
LIMITS = (
    "--worker-memory=3",
    "--max-prims=20000",
    "--max-instances=1000000",
    "--max-points=10000",
    "--max-texels=20000",
)
