"""One synthetic session and its batch run, shared by the tests of navigation."""

import numpy as np
import pytest
from hypothesis import settings

from mavkf.compiled import link_apart
from mavkf.navigation.offline import Offline, run_offline

from ._session import CONFIG, session

settings.register_profile("navigation", deadline=None)
settings.load_profile("navigation")


@pytest.fixture(scope="session", autouse=True)
def linked() -> None:
    """Functions that are compiled apart can be called by tests that call what calls them."""
    link_apart()


@pytest.fixture(scope="session")
def rows() -> np.ndarray:
    """40 s in the order of arrival, not to be written to."""
    made = session()
    made.setflags(write=False)
    return made


@pytest.fixture(scope="session")
def batch(rows: np.ndarray) -> Offline:
    return run_offline(rows, CONFIG)
