"""Write the tables of the README from the stored results: `python docs/readme.py`.

Each table stands between `<!-- results-table ... -->`, which describes it (`docs/tables.py`), and `<!-- end -->`.
`--check` writes nothing and exits with 1 where a table differs.
"""

import difflib
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import tables

README = Path(__file__).resolve().parents[1] / "README.md"
MARKED = re.compile(r"(<!-- results-table ([^\n]*)\n(.*?)-->\n).*?(<!-- end -->)", re.DOTALL)


def written(text: str) -> str:
    """Return the README with its tables as the files have them."""
    return MARKED.sub(lambda found: f"{found[1]}{tables.table(found[2].split(), found[3])}\n{found[4]}", text)


def main(check: bool) -> int:
    old = README.read_text("utf-8")
    new = written(old)
    if not check:
        README.write_text(new, "utf-8")
    changed = difflib.unified_diff(old.splitlines(), new.splitlines(), "README.md", "stored results", lineterm="", n=0)
    print(*changed, sep="\n")
    return int(check and old != new)


if __name__ == "__main__":
    raise SystemExit(main("--check" in sys.argv[1:]))
