"""Plant each fault of the lists in a scratch copy, run the tests named, and report who noticed.

    python tests/mutants/run.py [--jobs N] [--area AREA] [--match TEXT] [--fresh] [--json]

Without options every fault is judged (`make mutants`). A verdict is kept below build/mutants for as
long as nothing in the tree changes, so a run that was stopped goes on where it was. Exit code 1: a
survivor that is not explained as equivalent, one explained that a test does kill, an edit whose
text is gone, or a named test that does not pass without the fault.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from catalogue import AREAS, ROOT, Fault, plant, problem, read_faults, tree_digest

#: What is copied: all that the tests read.
PARTS = (
    *(".ci", ".dev", "Makefile", "README.md", "CHANGELOG.md", "LICENSE", "pyproject.toml"),
    *(
        "requirements.lock",
        "api",
        "cli",
        "derive",
        "docs",
        "generated",
        "runtime",
        "templates",
        "tests",
    ),
    *("paper", "benchmarks"),
)
_LEFT_OUT = ("__pycache__", "*.pyc", ".hypothesis", ".pytest_cache", "*.o")
WORK = ROOT / "build" / "mutants"
#: Seconds after which a run counts as caught: the fault keeps the tests from ending.
TIME_LIMIT = 300.0
_FIRST_MOMENT = 1_000_000_000
KILLED, SURVIVED, INVALID = "killed", "survived", "invalid"


@dataclass(frozen=True)
class Verdict:
    """What became of a fault: `outcome` is killed, survived or invalid, `note` says by what."""

    area: str
    what: str
    outcome: str
    note: str
    explained: str = ""

    def failure(self) -> str:
        """Return what is wrong with this verdict, or nothing."""
        if self.outcome == INVALID:
            return self.note
        if self.outcome == SURVIVED and not self.explained:
            return "survived, and nothing says why it may"
        if self.outcome == KILLED and self.explained:
            return "called equivalent, but a test tells it apart"
        return ""


class Laboratory:
    """A scratch copy of the tree with a cache of its own, in which faults are planted."""

    def __init__(self, folder: Path, warm: Path) -> None:
        """Copy the tree into `folder`; `warm` is a cache that every fault starts from."""
        self.root, self.folder, self.warm = folder / "tree", folder, warm
        copy_tree(self.root)

    def judge(self, fault: Fault, moment: int) -> Verdict:
        """Plant `fault`, generate what it says, run its tests, take it out again."""
        kept = {m: self.folder / f"kept-{m}" for m in fault.regenerate}
        for model, copy in kept.items():
            shutil.copytree(self.root / "generated" / model, copy)
        restore = plant(fault, self.root, moment)
        cache = self.folder / "cache"
        shutil.copytree(self.warm, cache, copy_function=os.link)
        try:
            outcome, note = self._outcome(fault, cache)
        finally:
            for one in restore:
                one()
            shutil.rmtree(cache, ignore_errors=True)
            for model, copy in kept.items():
                shutil.rmtree(self.root / "generated" / model)
                copy.rename(self.root / "generated" / model)
        return Verdict(fault.area, fault.what, outcome, note, fault.equivalent)

    def _outcome(self, fault: Fault, cache: Path) -> tuple[str, str]:
        for model in fault.regenerate:
            code = "import sys; from pfaffian.cli.main import main; sys.exit(main())"
            command = ["-c", code, "generate", model]
            exit_code, said = execute(command, self.root, cache, self.folder)
            if exit_code != 0:
                return KILLED, f"generate {model} refuses it: {said[-200:]}"
        command = ["-m", "pytest", "-x", *PYTEST, *(f"tests/{t}" for t in fault.tests)]
        exit_code, said = execute(command, self.root, cache, self.folder)
        if exit_code is None:
            return KILLED, f"no end within {TIME_LIMIT:g} s"
        if exit_code == 1:
            lines = [x for x in said.splitlines() if x.startswith(("FAILED", "ERROR"))]
            return KILLED, (lines or ["a test failed"])[0][:200]
        if exit_code == 0:
            return SURVIVED, ", ".join(fault.tests)
        return INVALID, f"pytest ended with {exit_code}: {said[-600:]}"


PYTEST = ("-p", "no:cacheprovider", "-p", "no:xdist", "--no-header", "--tb=line", "-rfE")


def copy_tree(target: Path) -> None:
    """Copy what the tests need of this tree into `target`."""
    target.mkdir(parents=True)
    for part in PARTS:
        source = ROOT / part
        if source.is_dir():
            ignore = shutil.ignore_patterns(*_LEFT_OUT)
            shutil.copytree(source, target / part, symlinks=True, ignore=ignore)
        elif source.exists():
            shutil.copy2(source, target / part)


def execute(
    command: Sequence[str], root: Path, cache: Path, folder: Path, limit: float | None = None
) -> tuple[int | None, str]:
    """Run Python in the tree at `root`; return its exit code (None: out of time) and its words."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    environment = {
        **os.environ,
        "PYTHONPATH": str(root / ".dev"),
        "PFAFFIAN_CACHE": str(cache),
        "TMPDIR": str(temporary),
        "COLUMNS": "400",
        "PFAFFIAN_THOROUGH": "1",
    }
    process = subprocess.Popen(
        [sys.executable, *command],
        cwd=root,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(timeout=limit or TIME_LIMIT)
        return process.returncode, said
    except subprocess.TimeoutExpired:
        return None, ""
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        shutil.rmtree(temporary, ignore_errors=True)


def baseline(faults: Iterable[Fault], folder: Path, warm: Path) -> dict[str, str]:
    """Run every named test without a fault; return what is wrong with those that do not pass."""
    tests = sorted({t for f in faults for t in f.tests})
    root = folder / "tree"
    copy_tree(root)
    report = folder / "report.xml"
    command = ["-m", "pytest", *PYTEST, f"--junitxml={report}", *(f"tests/{t}" for t in tests)]
    _, said = execute(command, root, warm, folder, limit=TIME_LIMIT * max(4, len(tests) / 4))
    if not report.is_file():
        return dict.fromkeys(tests, f"no verdict without a fault: {said[-600:]}")
    passed, others = set(), {}
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        file = case.attrib["classname"].rpartition(".")[2]
        name = f"{file}.py::{case.attrib['name']}"
        bad = [c.tag for c in case if c.tag in ("failure", "error", "skipped")]
        if bad:
            others[name] = bad[0]
        else:
            passed.add(name)
    return {t: why for t in tests if (why := _trouble(t, passed, others))}


def _trouble(test: str, passed: set[str], others: dict[str, str]) -> str:
    """Return why `test` cannot judge, or nothing; without brackets all its cases count."""

    def is_case(name: str) -> bool:
        return name == test or name.startswith(f"{test}[")

    bad = [f"{n}: {why}" for n, why in sorted(others.items()) if is_case(n)]
    if bad:
        return f"without the fault {bad[0]}"
    return "" if any(map(is_case, passed)) else f"{test} was not run"


def judge_all(faults: Sequence[Fault], jobs: int, fresh: bool = False) -> list[Verdict]:
    """Return the verdicts on `faults`, in their order, those known for this tree included."""
    files = [p for part in PARTS for p in _files(ROOT / part)]
    known_path = WORK / f"{tree_digest(files, ROOT)[:16]}.jsonl"
    known = {} if fresh else _known(known_path)
    open_ = [f for f in faults if f.digest() not in known]
    WORK.mkdir(parents=True, exist_ok=True)
    log_file = known_path.open("a", encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="mutants-") as name, log_file as log:
        for fault, verdict in _judged(open_, Path(name), jobs):
            known[fault.digest()] = verdict
            log.write(json.dumps({"digest": fault.digest(), **asdict(verdict)}) + "\n")
            log.flush()
            _say(f"{verdict.outcome:9}{verdict.area}: {verdict.what} ({verdict.note[:120]})")
    return [known[f.digest()] for f in faults]


def _judged(faults: Sequence[Fault], folder: Path, jobs: int) -> Iterable[tuple[Fault, Verdict]]:
    """Yield each fault with its verdict as it falls; the tests are tried without faults first."""
    if not faults:
        return
    warm = folder / "warm"
    warm.mkdir()
    _say(f"running the tests of {len(faults)} faults without any")
    (folder / "sound").mkdir()
    sound = [f for f in faults if not problem(f)]
    trouble = baseline(sound, folder / "sound", warm) if sound else {}
    laboratories: queue.Queue[Laboratory] = queue.Queue()
    for k in range(jobs):
        (folder / str(k)).mkdir()
        laboratories.put(Laboratory(folder / str(k), warm))

    def judge(number: int, fault: Fault) -> Verdict:
        blocked = problem(fault) or next((trouble[t] for t in fault.tests if t in trouble), "")
        if blocked:
            return Verdict(fault.area, fault.what, INVALID, blocked)
        laboratory = laboratories.get()
        try:
            return laboratory.judge(fault, _FIRST_MOMENT + number)
        finally:
            laboratories.put(laboratory)

    pool = ThreadPoolExecutor(jobs)
    try:
        running = {pool.submit(judge, k, f): f for k, f in enumerate(faults)}
        for done in as_completed(running):
            yield running[done], done.result()
    finally:  # an interrupt waits for what is running, and starts no more
        pool.shutdown(cancel_futures=True)


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return [
        p
        for p in path.rglob("*")
        if p.is_file() and not p.is_symlink() and "__pycache__" not in p.parts
    ]


def _known(path: Path) -> dict[str, Verdict]:
    if not path.is_file():
        return {}
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {row.pop("digest"): Verdict(**row) for row in rows}


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def by_area(verdicts: Iterable[Verdict]) -> list[tuple[str, int, int, int, int]]:
    """Return area, faults, killed, explained and other survivors: a row an area, then the sum."""
    every = list(verdicts)
    rows = []
    for area in (*AREAS, "together"):
        mine = [v for v in every if area in (v.area, "together")]
        killed = sum(v.outcome == KILLED for v in mine)
        explained = sum(v.outcome == SURVIVED and bool(v.explained) for v in mine)
        if mine:
            rows.append((area, len(mine), killed, explained, len(mine) - killed - explained))
    return rows


def table(verdicts: Iterable[Verdict]) -> str:
    """Return the rates by area as a Markdown table."""
    lines = ["| area | faults | killed | equivalent | others | rate |", "|---|---|---|---|---|---|"]
    for area, count, killed, explained, others in by_area(verdicts):
        rate = f"{100.0 * killed / count:.1f} %"
        lines.append(f"| {area} | {count} | {killed} | {explained} | {others} | {rate} |")
    return "\n".join(lines)


def main() -> int:
    """Judge the faults chosen and print the table, or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--jobs", type=int, default=2, help="faults judged at the same time")
    parser.add_argument("--area", choices=AREAS, help="only this list")
    parser.add_argument("--match", default="", help="only faults whose description holds this")
    parser.add_argument("--fresh", action="store_true", help="judge again what is known")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    chosen = parser.parse_args()
    faults = [
        f
        for f in read_faults()
        if chosen.area in (None, f.area) and chosen.match.lower() in f.what.lower()
    ]
    if not faults:
        parser.error("no fault of the lists is chosen by this")
    verdicts = judge_all(faults, max(1, chosen.jobs), chosen.fresh)
    failures = [(v, why) for v in verdicts if (why := v.failure())]
    document = {
        "faults": len(verdicts),
        "killed": sum(v.outcome == KILLED for v in verdicts),
        "areas": [
            dict(zip(("area", "faults", "killed", "equivalent", "others"), row, strict=True))
            for row in by_area(verdicts)
        ],
        "verdicts": [asdict(v) for v in verdicts],
    }
    (WORK / "report.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(document, indent=2) if chosen.json else table(verdicts))
    for verdict, why in failures:
        _say(f"error: {verdict.area}: {verdict.what}: {why}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
