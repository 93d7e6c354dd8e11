"""What several test files are given."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from ftcal.compute import Cluster


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """Yield a Dask cluster of one worker, in this process; skip where Dask is absent."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address=None,
        protocol="tcp",
        silence_logs=50,
    ) as running:
        yield Cluster(running.scheduler_address)
