"""What every test may ask for."""

import os
from pathlib import Path

# Before numpy is loaded: on small matrices, threads of the linear algebra cost three times what they gain, and the
# tests already fill the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

# No test is timed: machines are shared, and the first call of a compiled function takes seconds.
settings.register_profile("starbench", deadline=None)
settings.load_profile("starbench")


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder of recordings published by others; it is not part of the project and may be absent."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STARBENCH_REFERENCE_DATA", beside))
    if not folder.is_dir():
        pytest.skip("the reference recordings are not here; STARBENCH_REFERENCE_DATA names their folder")
    return folder
