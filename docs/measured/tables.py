"""Tables of `pfaffian reproduce`, as Markdown: for docs/experiment.md and docs/reproduction.md.

    python docs/measured/tables.py SECTION TABLE [TABLE ...]

The results are cached by content: the first table of a section takes minutes, the rest seconds.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path


def main(section: str, *names: str) -> None:
    """Print the tables of `section` that are named; all names where one is unknown."""
    command = [str(Path(sys.executable).with_name("pfaffian")), "reproduce", section, "--json"]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([*command, "-o", f"{folder}/page"], stdout=subprocess.PIPE, text=True)
    tables = json.loads(done.stdout)["tables"]
    for name in names:
        if name not in tables:
            sys.exit(f"{name}: not a table of {section}; one of {', '.join(tables)}")
        columns = tables[name]["columns"]
        rows = [[str(cell).replace("|", "\\|") for cell in row] for row in tables[name]["rows"]]
        heads = [column.replace("|", "\\|") for column in columns]
        print(f"| {' | '.join(heads)} |\n|{'---|' * len(columns)}")
        for row in rows:
            print(f"| {' | '.join(row)} |")
        print()


if __name__ == "__main__":
    main(*sys.argv[1:])
