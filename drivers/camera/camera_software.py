"""The software of other makers that a driver of a camera needs, and whether this computer has it."""

from __future__ import annotations

from drivers.errors import CameraSoftwareMissing


def missing_software(driver: str) -> list[str]:
    """Return, as sentences, which software of other makers a driver of a camera needs and this computer lacks."""
    # Each driver is imported only if it is asked about: it brings numba and the decoder.
    try:
        if driver == "metavision":
            from drivers.camera.metavision_discovery import vendor_software

            vendor_software()
        elif driver == "neuromorphic_evk4":
            from drivers.camera.neuromorphic_evk4 import import_package

            import_package()
    except CameraSoftwareMissing as error:
        return [str(error)]
    return []
