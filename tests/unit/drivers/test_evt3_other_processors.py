"""Events decoded with the instructions that all processors have are those decoded with the ones that some have."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from drivers.camera import word_vectors
from tests.unit.drivers.evt3_words import HEIGHT, WIDTH
from tests.unit.drivers.test_evt3_streams import sparse_words

DECODE = """
import sys
import numpy as np
from drivers.camera import word_vectors
word_vectors.COMPRESSES = sys.argv[2] == "True"
import hashlib
from drivers.camera.evt3 import Evt3Decoder
words = np.load(sys.argv[1])
digest = hashlib.sha256()
for events, _ in Evt3Decoder({width}, {height}).decode(words, max_events=5000):
    for field in events:
        digest.update(field.tobytes())
print(digest.hexdigest())
"""


def decoded_elsewhere(folder, words, compresses):
    """Return the hash of the events, decoded by a process of its own with code compiled anew."""
    np.save(folder / "words.npy", words)
    script = DECODE.format(width=WIDTH, height=HEIGHT)
    command = [sys.executable, "-c", script, str(folder / "words.npy"), str(compresses)]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder / str(compresses))}
    return subprocess.run(command, check=True, capture_output=True, text=True, env=env).stdout.strip()


@pytest.mark.slow
@pytest.mark.skipif(
    not word_vectors.COMPRESSES, reason="this processor cannot move words of a vector together"
)
def test_events_do_not_depend_on_the_processor(tmp_path):
    words = sparse_words(np.random.default_rng(2), 30_000)
    with_it, without = (decoded_elsewhere(tmp_path, words, compresses) for compresses in (True, False))
    assert with_it == without
    assert with_it != hashlib.sha256().hexdigest()
