"""The balances of a recording: ftcal against iDynTree asked sample by sample, one core.

    python benchmarks/balances.py --samples 100000 --rounds 5

A balance of a sub-model needs, for every sample, what the readings on its border must add up to and
the transform of each reading. Theirs: the estimator of external wrenches with readings of zero, and
`KinDynComputations` for the transforms, over a few thousand samples, scaled. Both start from joint
positions with their derivatives; filters are `filtering.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import icub_models
import numpy as np
from loops import external_loop, transform_loop
from measure import Benchmark, Record, interleaved

