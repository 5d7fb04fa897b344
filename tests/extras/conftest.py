"""What the tests of the extras share with those of the bench: a small sealed run, a key, views, a command called."""

from tests.unit.bench.commands.conftest import here, say  # noqa: F401
from tests.unit.bench.conftest import (  # noqa: F401
    calibrated_once,
    children,
    home,
    key,
    make_run,
    own_kept_views,
    points,
    sealed,
    sealed_once,
    signers,
)
