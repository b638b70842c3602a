"""The finger: mechanics, optics and the studies that join them.

A :class:`~data_schemas.FingerDesign`, ready-made (`preset_design`) or written as TOML (`design_toml`),
becomes a mesh that :mod:`sim.mechanics` presses; :mod:`sim.surface_meshes` turns meshes into the surfaces that
light meets; :mod:`sim.optics` renders them and sweeps the angle of the light; :mod:`sim.experiments` does both for a
painted finger and returns records. Mechanics and optics know nothing of each other. A compiled library is proven in
a child process before it is used here (`proof_failure`). Lengths in mm, angles in deg, forces in N.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim._designs import (
        PRESETS,
        SENSORS,
        design_inputs,
        design_toml,
        given_design,
        is_sensor,
        preset_design,
        preset_sensor,
        read_design,
        read_sensor,
        sensor_inputs,
        sensor_toml,
        with_pad_size,
    )
    from sim._library_proofs import is_installed, proof_failure
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "PRESETS",
    "SENSORS",
    "design_inputs",
    "design_toml",
    "given_design",
    "is_installed",
    "is_sensor",
    "preset_design",
    "preset_sensor",
    "proof_failure",
    "read_design",
    "read_sensor",
    "sensor_inputs",
    "sensor_toml",
    "with_pad_size",
]
