"""Mutate good URDFs and their meshes, and see that each is refused in one line or works, in 10 s of processor time.

A mutant has one to four mutations: of attributes, elements, the text, its encoding and a mesh. It takes both ways into
karolos: a robot is proposed from it, and an arm of its own loads it in each engine and takes some steps. This happens
in a process of its own.
"""

import random
import resource
import struct
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import trimesh
from support.torture import SEED, TIMES

from karolos.core.seeding import SeedTree
from karolos.errors import KarolosError
from karolos.plugins.starter import write_starter
from karolos.registry import load
from karolos.robots import poses
from karolos.robots.arm import Arm, ArmSettings
from karolos.simulation.engines import ENGINES, make_world
from karolos.simulation.interface import Camera, TaskNeeds

LIMIT_SECONDS = 10.0
"""Processor time that a mutant may take; on a busy machine sixty times as much by the clock."""
ROBOTS = {name: load("robots", name) for name in ("iiwa", "panda", "ur5")}
VALUES = (
    *("", " ", "x", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-1", "1", "1 2", "1 2 3 4", "0 0 0"),
    *("nan 0 0", "1e200 1e200 1e200", "1_000", "0x10", "\u0661", "1,5", "1e999", "a" * 5000, "\t\n", "\x7f", "\u202e"),
    *("..", "/dev/zero", "/etc/passwd", "package://", "file:///", "../" * 300, "\N{SNOWMAN}" * 300, "world", "%s%n"),
    *("1e6 1e6 1e6", "1e-9 1e-9 1e-9", "100", "1e5", "1e-12", "6.28318"),
)
TAGS = ("torus", "box", "sphere", "cylinder", "capsule", "mesh", "limit", "axis", "origin", "link", "joint", "x:y", "z")
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "", "x")
OBJ_LINES = (
    *("f 1 2 9", "f 0 1 2", "f -1 -2 -9", "f 1 2", "f 1", "f", "f 99999999999999999999 1 2", "f 1/9/9 2/9/9 3/9/9"),
    *("f 1//1 2//2 3//3", "f a b c", "f 1 2 3 4 1 2 3 4", "f " + "1 " * 5000, "v nan 0 0", "v 1 2", "v", "v 1e308 0 0"),
    *("v 1e20 0 0", "vt 0", "vn", "mtllib /dev/zero", "mtllib ../x.mtl", "usemtl x", "l 1 2", "p 1", "g " + "x" * 5000),
    *("\\", "v 0 0 0 \\", "f 1 2 3 # 9", "\0", "\n" * 1_000_000, " \n" * 10_000, "v 0 0 0\n" * 100_000, "#\n" * 10_000),
)
CORNERS = ("0 0 0", "0 0 .01", "0 .01 0", ".01 0 0")
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
BINARY = b"".join(
    struct.pack("<12fH", 0, 0, 0, *(float(word) for at in face for word in CORNERS[at].split()), 0) for face in FACES
)
ASCII = "".join(f"facet\n{''.join(f'vertex {CORNERS[at]} ' + chr(10) for at in face)}endfacet\n" for face in FACES)
FACE_LINES = "".join("f {} {} {}\n".format(*(at + 1 for at in face)) for face in FACES)
MESHES = {
    "solid.obj": ("".join(f"v {corner}\n" for corner in CORNERS) + FACE_LINES).encode(),
    "binary.stl": bytes(80) + struct.pack("<I", 4) + BINARY,
    "ascii.stl": f"solid x\n{ASCII}endsolid x\n".encode(),
    "solid.dae": trimesh.exchange.dae.export_collada(trimesh.creation.box((0.01, 0.02, 0.03))),
}


def sources() -> dict[str, bytes]:
    """Good URDFs: those of the built-in robots, with meshes of every format."""
    found = {}
    for robot, plugin in ROBOTS.items():
        tree = ElementTree.parse(plugin.model.urdf).getroot()
        for link, name in zip(tree.findall("link")[1:], (*MESHES, *MESHES), strict=False):
            for kind in ("visual", "collision"):
                geometry = ElementTree.SubElement(ElementTree.SubElement(link, kind), "geometry")
                ElementTree.SubElement(geometry, "mesh").set("filename", f"meshes/{name}")
        found[robot] = ElementTree.tostring(tree)
    return found


def change_element(tree: Element, draw: random.Random) -> None:
    """Drop, double, move or rename an element."""
    parent, element = draw.choice([(parent, child) for parent in tree.iter() for child in parent])
    kind = draw.randrange(4)
    if kind == 0:
        parent.remove(element)
    elif kind == 1:
        parent.append(element)
    elif kind == 2:
        element.tag = draw.choice(TAGS)
    elif (other := draw.choice([*tree.iter()])) not in [*element.iter()]:
        other.append(element)


def change_value(tree: Element, draw: random.Random) -> None:
    """Put or drop an attribute, or one of its numbers."""
    element, key = draw.choice([(element, key) for element in tree.iter() for key in element.attrib])
    words, value = element.attrib[key].split(), draw.choice(VALUES)
    kind = draw.randrange(4)
    if kind == 0:
        del element.attrib[key]
    elif kind == 1 or not words:
        element.set(key, value)
    else:
        words[draw.randrange(len(words))] = value
        element.set(key, " ".join(words))


def change_kind(tree: Element, draw: random.Random) -> None:
    draw.choice(tree.findall("joint") or [tree]).set("type", draw.choice(KINDS))


def lengthen(tree: Element, draw: random.Random) -> None:
    """Add a chain or a star of joints."""
    parent = draw.choice([link.get("name", "") for link in tree.findall("link")] or ["x"])
    kind, star = draw.choice(KINDS[:4]), draw.random() < 0.3
    for number in range(draw.choice((3, 30, 100, 300, 2000))):
        above = parent if star or not number else f"more{number - 1}"
        text = (
            f'<x><link name="more{number}"><inertial><mass value=".1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3"/>'
            f'</inertial></link><joint name="further{number}" type="{kind}"><parent/><child link="more{number}"/>'
            f'<origin xyz="0 0 .05"/><axis xyz="{draw.choice(("0 0 1", "0 1 0"))}"/>'
            '<limit lower="-2" upper="2" effort="9" velocity="2"/></joint></x>'
        )
        tree.extend(added := ElementTree.fromstring(text))
        added[1][0].set("link", above)


def break_bytes(data: bytes, draw: random.Random) -> bytes:
    """Change a file below its structure."""
    place, kind = draw.randrange(len(data) + 1), draw.randrange(6)
    noise = draw.randbytes(draw.choice((0, 1, 10, 84, 134, 5000)))
    middle = (data[:place], data[:place] + noise[:1] + data[place + 1 :], data[:place] + noise + data[place:])
    return (*middle, noise, data[: place // 2] + data[place:], data * draw.choice((2, 50)))[kind]


def break_text(data: bytes, draw: random.Random) -> bytes:
    """Change a URDF as a text: its encoding, entities, depth, spaces and references."""
    text, kind = data.decode("utf-8", "replace"), draw.randrange(7)
    if kind == 0:
        encoding = draw.choice(("iso-8859-1", "utf-16", "cp1252", "utf-32", "utf-7", "x"))
        text = text.replace('name="', 'name="\N{LATIN SMALL LETTER U WITH DIAERESIS}', draw.choice((0, 1)))
        written = "utf-8" if encoding == "x" else encoding
        return f'<?xml version="1.0" encoding="{encoding}"?>{text}'.encode(written, "replace")
    if kind == 1:
        return draw.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"\n\n", b"<!-- x -->")) + data
    if kind == 2:
        more = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
        system = '<!ENTITY e11 SYSTEM "file:///etc/passwd">' if draw.random() < 0.5 else more
        text = f'<!DOCTYPE robot [<!ENTITY e0 "lol">{system}]>{text.replace("<link ", "&e11;<link ", 1)}'
    elif kind == 3:
        depth = draw.choice((10, 1000, 100_000))
        text = text.replace("</robot>", "<link>" * depth + "</link>" * depth + "</robot>")
    elif kind == 4:
        text = text.replace("<link ", f"{' ' * draw.choice((10, 5_000_000))}<link ", 1)
    elif kind == 5:
        text = text.replace('name="', f'name="{draw.choice(("&#10;", "&#0;", "&lt;", "&x;", chr(0xFFFE)))}', 2)
    else:
        return break_bytes(data, draw)
    return text.encode("utf-8", "replace")


def break_mesh(name: str, data: bytes, draw: random.Random) -> bytes:
    if draw.random() < 0.3:
        return break_bytes(data, draw)
    if name == "binary.stl":
        count, number = draw.choice((0, 1, 3, 5, 2**31, 2**32 - 1)), draw.choice((float("nan"), 1e38, 1e-45, -1e10))
        changed = data[:80] + struct.pack("<I", count) + data[84:], data[:96] + struct.pack("<f", number) + data[100:]
        return draw.choice((*changed, b"solid" + data[5:], data[:84] + data[84:134] * 1000))
    lines = data.decode("latin-1").splitlines()
    if draw.random() < 0.6 and name == "solid.obj":
        lines.insert(draw.randrange(len(lines) + 1), draw.choice(OBJ_LINES))
    else:
        at = draw.randrange(len(lines) or 1)
        words = lines[at].split() if lines else [""]
        words[-1:] = [draw.choice(("-1", "99", "4000000000", "nan", "1e308", "x", "", "1e5"))]
        lines[at:] = [" ".join(words), *lines[at + 1 :]]
    return "\n".join(lines).encode("latin-1")


def write_mutant(folder: Path, originals: dict[str, bytes], draw: random.Random) -> tuple[str, Path]:
    """Write a mutated URDF and its meshes; returns the robot that it was made from, and its path."""
    robot, files = draw.choice([*originals]), dict(MESHES)
    data = originals[robot]
    for _ in range(draw.choice((1, 1, 1, 2, 2, 4))):
        part = draw.random()
        if part < 0.25:
            name = draw.choice([*files])
            files[name] = break_mesh(name, files[name], draw)
        elif part < 0.85:
            try:
                tree = ElementTree.fromstring(data)
                draw.choice((change_value,) * 5 + (change_element,) * 4 + (change_kind, lengthen))(tree, draw)
                data = ElementTree.tostring(tree)
            except (ElementTree.ParseError, LookupError, ValueError, RecursionError):
                continue  # broken by the mutation before
        else:
            data = break_text(data, draw)
    (folder / "meshes").mkdir(parents=True)
    for name, content in files.items():
        (folder / "meshes" / name).write_bytes(content)
    (path := folder / "robot.urdf").write_bytes(data)
    return robot, path


def load_into(engine: Any, robot: str, path: Path) -> None:
    """Take steps with an arm whose own URDF is this one."""
    members = {"model": replace(ROBOTS[robot].model, urdf=path), "Settings": ArmSettings}
    arm: Any = type("Mutant", (Arm,), members)(ArmSettings())
    arm.prepare(TaskNeeds(gripper=True, period=1 / 24))
    world = make_world(engine)
    try:
        arm.build(world)
        arm.reset(SeedTree(0).generator())
        for _ in range(3):
            arm.act([0.5] * arm.action.size)
            world.step()
            arm.read()
        world.render(32, 32, Camera())
    finally:
        world.close()


def outcome(call: Callable[..., object], *arguments: Any, **more: Any) -> str:
    """What became of it: "works", "refused" with its line, or a traceback."""
    try:
        call(*arguments, **more)
    except KarolosError as error:
        line = str(error)
        return f"refused: {line}" if line.isprintable() and len(line) < 1000 else f"no short line: {line[:3000]!r}"
    except BaseException as error:  # a fault of any kind is what is looked for
        return "".join(traceback.format_exception(error))
    return "works"


def serve(connection: Connection) -> None:
    """Try the URDFs that come in. Proposals search less than usual, and nine of ten for a home from one start only."""
    starts = poses.STARTS
    poses.CONFIGURATIONS, poses.ENOUGH, poses.GRID = 1, 0.2, (3, 3, 3)
    while True:
        (robot, path), start = connection.recv(), time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(start + LIMIT_SECONDS) + 1, resource.RLIM_INFINITY))
        poses.STARTS = 1 if int(path.parent.name) % 10 else starts
        found = {"proposed": outcome(write_starter, "robot", "mine", path.parent / "new", urdf=path)}
        found |= {one: outcome(load_into, one, robot, path) for one, engine in ENGINES.items() if engine.installed}
        connection.send((found, time.process_time() - start))


def judged(numbers: range, seed: int, folder: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Number and outcomes of each mutant. A process that dies or hangs is replaced."""
    originals, context = sources(), get_context("spawn")
    process: Any = None
    for number in numbers:
        if process is None:
            own, other = context.Pipe()
            process = context.Process(target=serve, args=(other,), daemon=True)
            process.start()
            other.close()
        own.send(write_mutant(folder / str(number), originals, random.Random(f"{seed} {number}")))
        found = {"all": "took too long"}
        try:
            if own.poll(60 * LIMIT_SECONDS):
                outcomes, seconds = own.recv()
                found = outcomes if seconds < LIMIT_SECONDS else found
        except EOFError:
            process.join()
            found = {"all": f"the process died with {process.exitcode}"}
        if "all" in found:
            process.kill()
            process = None
        yield number, found
    if process is not None:
        process.kill()


def test_mutated_urdfs_work_or_are_refused_in_one_line(tmp_path):
    numbers = range(1, 1 + 4 * TIMES)
    found = dict(judged(numbers, SEED, tmp_path))
    assert list(found) == list(numbers)
    for number, outcomes in found.items():
        for way, what in outcomes.items():
            assert what.startswith(("works", "refused")), f"mutant {number}, {way}: {what}"
