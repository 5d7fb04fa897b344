"""Compiles all loops after an installation: `python -m bench.warm_up`."""

import os

from bench.base.compiled_loops import SIMULATOR, STARS, compile_loops
from bench.base.kernel_cache import remove_stale_kernels, set_kernel_cache

if __name__ == "__main__":
    set_kernel_cache(os.environ)
    remove_stale_kernels()
    compile_loops(STARS, SIMULATOR)
