"""Contract tests for drivers of other packages: import `StageContract` or `LightContract` into a test module.

The suite puts a simulated device on a pseudo-terminal behind a line of faults, and opens the driver by its section of a
station file, as a run does. It needs pytest, and Linux or macOS. docs/plugins.md explains it. No run uses this package.
"""

from bench.plugin_tests.lights import LightContract
from bench.plugin_tests.rig import SimulatedLight, SimulatedStage
from bench.plugin_tests.stages import StageContract

__all__ = ["LightContract", "SimulatedLight", "SimulatedStage", "StageContract"]
