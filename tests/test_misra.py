"""cppcheck with its MISRA addon finds what docs/misra.md has a reason for, and nothing else."""

import re
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path

import pytest
from conftest import REPOSITORY
from pfaffian.runtime.code.generated_model import open_generated

needs_cppcheck = pytest.mark.skipif(
    not shutil.which("cppcheck"), reason="needs cppcheck: apt-get install cppcheck"
)
ROW = re.compile(r"^\| (\S+) \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)
FINDING = re.compile(r"^(\S+) (\S+):(\d+) (\w+) ?(.*)$", re.MULTILINE)
RUNTIME = Path(str(files("pfaffian.runtime"))) / "c"


def deviations():
    """Return the files of each rule that docs/misra.md names."""
    found = {}
    for rule, names, reason in ROW.findall((REPOSITORY / "docs" / "misra.md").read_text()):
        if rule not in ("rule", "---"):
            assert rule not in found
            assert len(reason) > 15
            found[rule] = set(names.split())
    return found


def check(sources, *includes):
    """Return the findings of cppcheck as (rule, file, line, severity)."""
    command = ["cppcheck", "--std=c99", "--addon=misra", "--quiet", "--platform=unix32"]
    command += ["--enable=warning,performance,portability", "--suppress=missingIncludeSystem"]
    command += ["--template={id} {file}:{line} {severity} {message}"]
    command += [f"-I{i}" for i in includes]
    done = subprocess.run(
        [*command, *map(str, sources)], capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return [
        (name.removeprefix("misra-c2012-"), Path(path).name, int(line), severity)
        for name, path, line, severity, _ in FINDING.findall(done.stdout + done.stderr)
    ]


def unexplained(findings, model):
    """Return what no row of the document allows."""
    allowed = deviations()
    found = {
        (rule, re.sub(rf"^{model}(_\w+)?\.", "model.", name), line)
        for rule, name, line, _ in findings
    }
    return [f for f in sorted(found) if not {f[1], "*"} & allowed.get(f[0], set())]


@needs_cppcheck
def test_every_finding_has_a_reason_and_every_reason_a_finding():
    c = open_generated("pendubot").path / "c"
    sources = [*sorted(c.glob("*.c")), *sorted(RUNTIME.glob("*.c"))]
    sources += sorted((RUNTIME / "ppc_bare").glob("*.c"))
    findings = check(sources, c, RUNTIME)
    assert not unexplained(findings, "pendubot")
    plain = open_generated("chain").path / "c"  # without a complete controller
    findings += check([plain / "chain.c"], plain)
    assert {rule for rule, *_ in findings} == set(deviations())


@needs_cppcheck
@pytest.mark.parametrize("model", ["chain", "pvtol"])
def test_other_models_deviate_where_the_pendubot_does(model):
    c = open_generated(model).path / "c"
    findings = check([c / f"{model}.c", c / f"{model}_plant.c"], c)
    assert findings
    assert not unexplained(findings, model)


@needs_cppcheck
def test_a_planted_overrun_is_found(tmp_path):
    (tmp_path / "wrong.c").write_text(
        "double wrong(int k);\n"
        "double wrong(int k)\n"
        "{\n    double row[4] = {0.0};\n    int i;\n"
        "    for (i = 0; i <= 4; ++i) {\n        row[i] = (double)k;\n    }\n"
        "    return row[0];\n}\n"
    )
    assert "arrayIndexOutOfBounds" in {rule for rule, *_ in check([tmp_path / "wrong.c"])}


WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"]
WARNINGS += ["-Wdouble-promotion", "-Wstrict-prototypes", "-Wmissing-prototypes", "-Wcast-qual"]
COMPILERS = {
    "gcc": ("gcc", "-fanalyzer"),
    "clang": ("clang",),
    "powerpc-linux-gnu-gcc": ("powerpc-linux-gnu-gcc", "-mcpu=750"),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.skipif(not shutil.which(n), reason=f"needs {n}"))
        for n in COMPILERS
    ],
)
def test_compilers_have_nothing_to_say(name, tmp_path):
    c = open_generated("pendubot").path / "c"
    sources = [*sorted(c.glob("*.c")), *sorted(RUNTIME.glob("*.c"))]
    sources += sorted((RUNTIME / "linux").glob("*.c"))
    if name.startswith("powerpc"):
        sources += sorted((RUNTIME / "ppc_bare").glob("*.c"))
    for source in sources:
        hosted = [] if "linux" in str(source) else ["-ffreestanding"]
        command = [*COMPILERS[name], "-std=c99", "-O2", *hosted, *WARNINGS, "-Werror", f"-I{c}"]
        command += [
            f"-I{RUNTIME}",
            f"-I{RUNTIME / 'linux'}",
            "-c",
            str(source),
            "-o",
            str(tmp_path / "one.o"),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
