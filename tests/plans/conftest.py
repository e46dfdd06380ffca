"""A matrix that nobody disturbed, for all tests of a worker."""

from __future__ import annotations

import pytest
from support.transfer_samples import run_matrix

from karolos.plans.matrix import Matrix


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Matrix:
    return run_matrix(tmp_path_factory.mktemp("runs"))[0]
