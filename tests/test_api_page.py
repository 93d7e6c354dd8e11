"""The page on the Python API names what there is, and its example runs as it stands there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

import pretend

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "api.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"ftcal(?:\.\w+)+", PAGE.split("```python")[0])))


@pytest.mark.parametrize("name", NAMES)
def test_what_the_page_names_is_there(name: str) -> None:
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[cut:]:
            found = getattr(found, attribute)
        return
    pytest.fail(f"no module of {name}")


def test_the_example_of_the_page_fits_a_sensor(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    prior = pretend.workbench()
    true = pretend.bent(prior, np.random.default_rng(1))
    some = pretend.samples(true, np.random.default_rng(2))
    names = {
        "C_w": prior.gain,
        "full_scale": prior.full_scale,
        "time": some.time,
        "channels": some.channels,
        "model_wrench": some.wrench,
    }
    exec(compile(example, "docs/api.md", "exec"), names)
    estimate = names["found"].estimate  # type: ignore[attr-defined]
    # noise of 1e-4 of full scale under loads of 5 %
    assert np.abs(estimate.gain - true).max() < 0.05 * np.abs(prior.gain - true).max()
    assert capsys.readouterr().out.rstrip().endswith("6")
