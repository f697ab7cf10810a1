"""What a user installs is whole: sdist, wheel built from it, a fresh environment, the commands."""

import ast
import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("api", "derive", "generated", "runtime", "templates", "cli", "paper", "benchmarks")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
#: One file each of what has been lost from wheels before: code, templates, C, data.
NEEDED = (
    *("api/model.py", "__init__.py", "py.typed"),
    *("derive/mechanics/lagrange.py", "derive/emit/files/c.py", "derive/models/pendubot/spec.py"),
    *("derive/models/pendubot/sim.toml", "derive/verify/__init__.py", "cli/main.py"),
    *("templates/c/step.c.j2", "templates/python/model.py.j2", "runtime/c/pf_harness.c"),
    *("templates/bench/hand.c", "templates/bench/hand.h"),
    *("runtime/c/pf_sensing.c", "runtime/c/pf_sensing.h", "runtime/c/pf_sensing_harness.c"),
    *("runtime/c/pf_supervisor.c", "runtime/c/pf_supervisor.h"),
    "runtime/c/pf_supervisor_harness.c",
    *("generated/pendubot/c/pendubot.c", "generated/pendubot/manifest.json"),
    *("generated/pendubot/pendubot.py", "runtime/scenarios/section-5.1-designed.toml"),
)

#: What makes `pfaffian` itself a package, and where it stands in the repository.
FACE = {n: f".dev/pfaffian/{n}" for n in ("__init__.py", "py.typed")}


def run(*command, cwd, **environment):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PFAFFIAN"))}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=kept | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout


def build(kind, source, folder):
    """Build one distribution of `source` with the backend of this environment; return its path."""
    words = ("-m", "build", f"--{kind}", "--no-isolation", "--outdir", folder, source)
    run(sys.executable, *words, cwd=folder)
    (found,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return found


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    """The source distribution, unpacked."""
    for name in ("build", "hatchling", "editables"):
        pytest.importorskip(name, reason="needs the extra dev: pip install -e '.[dev]'")
    folder = tmp_path_factory.mktemp("sdist")
    archive = build("sdist", ROOT, folder)
    with tarfile.open(archive) as file:
        links = [m.name for m in file.getmembers() if not (m.isfile() or m.isdir())]
        file.extractall(folder)
    return SimpleNamespace(path=folder / archive.name.removesuffix(".tar.gz"), links=links)


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory):
    return build("wheel", sdist.path, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def fresh(wheel, tmp_path_factory):
    """A fresh environment with the wheel; its dependencies are those of this environment."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv" / "bin" / "python"
    words = ("install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps")
    run(python, "-m", "pip", *words, wheel, cwd=folder)
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    paths = sysconfig.get_paths()
    # A folder named in a .pth file is searched last, and its own .pth files are not read: the
    # live install of this environment stays out.
    (site / "dependencies.pth").write_text(f"{paths['purelib']}\n{paths['platlib']}\n")
    empty = folder / "empty"
    empty.mkdir()
    return SimpleNamespace(python=python, site=site, empty=empty, cache=folder / "cache")


def pfaffian(fresh, *words):
    command = fresh.python.parent / "pfaffian"
    return run(command, *words, cwd=fresh.empty, PFAFFIAN_CACHE=str(fresh.cache))


def files_below(folder):
    paths = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    return {p.as_posix() for p in paths if "__pycache__" not in p.parts}


def test_sdist_holds_the_real_folders_and_no_links(sdist):
    assert not sdist.links
    found = files_below(sdist.path)
    assert {FACE.get(n, n) for n in NEEDED} <= found
    assert {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "PKG-INFO"} <= found
    assert {p.split("/")[0] for p in found if "/" in p} >= set(FOLDERS)
    assert not [p for p in found if p.startswith((".dev", ".venv")) and p not in FACE.values()]
    assert not [p for p in found if p.endswith(".pyc")]


def test_sdist_holds_every_committed_file_of_the_package(sdist):
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    tracked = run("git", "ls-files", "-z", *FOLDERS, cwd=ROOT).split("\0")
    wanted = {name for name in tracked if name and (ROOT / name).is_file()}
    assert len(wanted) > 50
    assert wanted <= files_below(sdist.path)


def test_wheel_holds_every_file_of_the_sdist_under_the_package(sdist, wheel):
    with zipfile.ZipFile(wheel) as file:
        found = {n for n in file.namelist() if ".dist-info/" not in n}
    wanted = {f"pfaffian/{n}" for n in files_below(sdist.path) if n.split("/")[0] in FOLDERS}
    assert found == wanted | {f"pfaffian/{n}" for n in FACE}
    assert {f"pfaffian/{n}" for n in NEEDED} <= found


def test_wheel_holds_no_path_of_this_machine(wheel):
    places = [str(p).encode() for p in {ROOT, Path.home()} if len(p.parts) > 1]
    with zipfile.ZipFile(wheel) as file:
        for name in file.namelist():
            content = file.read(name)
            assert not [p for p in places if p + b"/" in content], name


def test_wheel_declares_its_command_and_its_dependencies(wheel):
    with zipfile.ZipFile(wheel) as file:
        (name,) = (n for n in file.namelist() if n.endswith(".dist-info/METADATA"))
        metadata = file.read(name).decode()
        entry_points = file.read(name.replace("METADATA", "entry_points.txt")).decode()
    assert "pfaffian = pfaffian.cli.entry:main" in entry_points
    required = {Requirement(r).name for r in re.findall(r"^Requires-Dist: (.*)", metadata, re.M)}
    assert {Requirement(r).name for r in PROJECT["project"]["dependencies"]} <= required
    assert "pfaffian" not in required


_WHERE = """
import importlib, json
names = [f"pfaffian.{n}" for n in ("api", "derive", "generated", "runtime", "templates", "cli")]
names += ["pfaffian.paper", "pfaffian.benchmarks"]
print(json.dumps({n: importlib.import_module(n).__file__ for n in names}))
"""


def test_every_package_is_imported_from_the_wheel(fresh):
    where = json.loads(run(fresh.python, "-c", _WHERE, cwd=fresh.empty))
    for name, path in where.items():
        assert Path(path).is_relative_to(fresh.site), name


_EVERY = """
import importlib, pkgutil, sys
import pfaffian.api, pfaffian.derive, pfaffian.runtime, pfaffian.cli, pfaffian.generated
import pfaffian.paper, pfaffian.benchmarks
for package in (
    *(pfaffian.api, pfaffian.derive, pfaffian.runtime, pfaffian.cli, pfaffian.generated),
    *(pfaffian.paper, pfaffian.benchmarks),
):
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(found.name)
print(*(n for n in sys.modules if n.startswith("pfaffian.")))
"""


def test_every_module_can_be_imported(fresh):
    loaded = run(fresh.python, "-c", _EVERY, cwd=fresh.empty).split()
    assert {"pfaffian.derive.lower.to_program", "pfaffian.runtime.flight.closed_loop"} <= set(
        loaded
    )
    assert "pfaffian.generated.pendubot.pendubot" in loaded


def test_installed_generator_gives_the_committed_bytes_in_an_empty_directory(fresh):
    pfaffian(fresh, "generate", "pendubot", "-o", "out")
    out, committed = fresh.empty / "out", ROOT / "generated" / "pendubot"
    names = files_below(committed)
    assert files_below(out) == names
    assert "c/pendubot.c" in names
    differing = [n for n in names if (out / n).read_bytes() != (committed / n).read_bytes()]
    assert not differing


def test_installed_command_flies_a_scenario_and_lists_models(fresh):
    flight = json.loads(pfaffian(fresh, "simulate", "section-5.1-designed", "--json"))
    wanted = {"steps", "mode", "iae_q1", "iae_q2", "mae2_q1", "mae2_q2", "peak_torque"}
    assert wanted | {"trajectory_sha256"} <= set(flight)
    assert flight["steps"] > 1000
    assert "pendubot" in pfaffian(fresh, "models", "--json")


CLIENT = """import pfaffian as pf

version: str = pf.__version__
names: list[str] = [row.name for row in pf.models()]
model: pf.Model = pf.load("pendubot")
p = model.parameters("sim-designed", m2="0.8 kg")
mass: float = p["m2"]
gains: dict[str, float] = dict(model.design(poles=[-6, -6, -6]).gains)
flight = model.simulate("section-5.1-designed", duration="0.1 s")
periods: int = len(flight)
iae: float = flight.metrics["iae_q1"]
torque = model.controller(p).step(q1=1.0, q2=0.5, dq1=0.0, dq2=0.0)
try:
    pf.load("pendulum-of-nobody")
except pf.InputError as error:
    remedy: str = error.remedy
print(version, len(names), mass, periods, remedy)
"""


def test_installed_package_is_typed_and_its_client_runs(fresh):
    client = fresh.empty / "client.py"
    client.write_text(CLIENT)
    words = ("-m", "mypy", "--strict", "--cache-dir", fresh.cache / "mypy", "client.py")
    run(fresh.python, *words, cwd=fresh.empty)
    said = run(fresh.python, "client.py", cwd=fresh.empty, PFAFFIAN_CACHE=str(fresh.cache))
    assert said.split()[:4] == [PROJECT["project"]["version"], "10", "0.8", "100"]
    wrong = CLIENT.replace("pf.load(", "pf.lod(")
    client.write_text(wrong)
    command = [str(w) for w in (fresh.python, *words)]
    judged = subprocess.run(command, cwd=fresh.empty, capture_output=True, text=True, check=False)
    assert judged.returncode == 1
    assert 'Module has no attribute "lod"' in judged.stdout


def python_files():
    folders = (*FOLDERS, "tests", "docs")
    return [p for f in folders for p in sorted((ROOT / f).rglob("*.py"))]


def imported_names(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield f"{'.' * node.level}{node.module or ''}"


def test_nothing_is_imported_under_a_second_name():
    files = python_files()
    assert len(files) > 50
    for path in files:
        for name in imported_names(path):
            assert name.split(".")[0] not in FOLDERS, f"{path.relative_to(ROOT)}: {name}"


@pytest.fixture(scope="module")
def lock():
    path = ROOT / "requirements.lock"
    assert path.is_file(), "requirements.lock is missing"
    return path.read_text(encoding="utf-8")


def pins(lock):
    rows = [line.strip() for line in lock.splitlines()]
    rows = [r for r in rows if r and not r.startswith("#")]
    found = [re.fullmatch(r"([A-Za-z0-9][\w.-]*)==([\w.+!-]+)", r) for r in rows]
    assert all(found), [r for r, m in zip(rows, found, strict=True) if not m]
    return {canonicalize_name(m[1]): m[2] for m in found}


def test_lock_names_no_index_no_url_and_no_path(lock):
    assert not re.search(r"://|--|^-|index|\bfile:|@|/|\\", lock, re.MULTILINE)
    assert str(ROOT) not in lock


def test_lock_pins_every_dependency_within_its_bounds(lock):
    project, pinned = PROJECT["project"], pins(lock)
    extras = project["optional-dependencies"].values()
    needed = [*project["dependencies"], *(r for e in extras for r in e)]
    needed += PROJECT["build-system"]["requires"]
    for requirement in map(Requirement, needed):
        name = canonicalize_name(requirement.name)
        assert name in pinned, name
        assert requirement.specifier.contains(pinned[name], prereleases=True), requirement
    assert "pfaffian" not in pinned
