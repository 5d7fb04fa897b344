"""Contract tests for drivers of other packages: of stages, lights, event cameras and frame cameras.

Import one into a test module, and derive from it. The suite opens the driver by its section of a station file, as a run
does; a simulated stage or light is on a pseudo-terminal behind a line of faults. It needs pytest, and Linux or macOS.
docs/plugins.md explains it. No run uses this package.
"""

from bench.extras.plugin_tests.cameras import CameraContract, FrameCameraContract, SimulatedCamera
from bench.extras.plugin_tests.rig import LibraryStage, SimulatedLight, SimulatedStage
from bench.extras.plugin_tests.stages import LibraryStageContract, LightContract, StageContract

__all__ = [
    "CameraContract",
    "FrameCameraContract",
    "LibraryStage",
    "LibraryStageContract",
    "LightContract",
    "SimulatedCamera",
    "SimulatedLight",
    "SimulatedStage",
    "StageContract",
]
