"""Where the real recordings lie, and the mark that skips a test where they do not."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
GENOVA02 = DATA / "icub-genova02"

needs_genova02 = pytest.mark.skipif(
    not GENOVA02.is_dir(), reason="shared/data/icub-genova02 is not here"
)
REAL_JOB = ROOT / "examples" / "real_icub" / "job.toml"
