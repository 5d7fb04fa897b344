import pytest
from align_fakes import fake_session


@pytest.fixture
def opened():
    """A session with fakes, open, and the fakes."""
    session, devices = fake_session()
    assert session.open() is None
    yield session, devices
    session.close()
