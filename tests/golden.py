"""Text that people read, pinned: a change of it is a change someone has looked at.

`FTCAL_GOLDEN=update pytest` writes the files anew; `git diff` then shows what changed.
"""

from __future__ import annotations

import os
from pathlib import Path

FOLDER = Path(__file__).parent / "golden"


def check(name: str, text: str) -> None:
    """Compare `text` to `tests/golden/NAME`, or write it there with `FTCAL_GOLDEN=update`."""
    path = FOLDER / name
    if os.environ.get("FTCAL_GOLDEN") == "update":
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")
        return
    assert path.exists(), f"no golden file {name}; write it with FTCAL_GOLDEN=update"
    assert text == path.read_text(encoding="utf-8"), f"{name} differs; see tests/golden.py"
