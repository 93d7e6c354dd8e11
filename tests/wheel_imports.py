"""Import every module of ftcal from the folder given, so that a wheel is seen to be whole.

Not a test of pytest: `make wheel-test` runs it in a process that sees the wheel first.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path

import ftcal

if __name__ == "__main__":
    expected = Path(sys.argv[1]).resolve() / "ftcal"
    found = Path(ftcal.__file__).resolve().parent
    if found != expected:
        sys.exit(f"ftcal was imported from {found}, not from the wheel in {expected}")
    names = [module.name for module in pkgutil.walk_packages(ftcal.__path__, "ftcal.")]
    for name in names:
        if not name.endswith("__main__"):  # importing it would run the command line
            importlib.import_module(name)
    sys.stdout.write(f"{len(names)} modules imported from the wheel\n")
