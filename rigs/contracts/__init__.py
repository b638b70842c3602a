"""What every device of a rig must do: the same tests for all implementations and users' own rigs.

On a rig of your own: ``pytest --pyargs rigs.contracts --rig my-rig.toml``. For a driver of
your own, a class of tests derives from one of the contracts and brings its fixtures: :class:`CameraContract` `camera`
(open) and `camera_settings`, :class:`FilterWheelContract` `wheel` (open) and `wheel_settings`, :class:`LightContract`
`light` (open), :class:`StageContract` `stage` and `stage_settings`, :class:`LoadCellContract` `load_cell` and
`load_cell_settings`. The contracts need pytest.
"""

from typing import TYPE_CHECKING

from data_schemas import MissingExtraError, lazy_exports

try:
    import pytest
except ImportError as error:
    raise MissingExtraError(
        f"the contract tests of the devices need pytest ({error}); install it with pip install pytest"
    ) from error

if TYPE_CHECKING:
    from rigs.contracts.devices import (
        CameraContract,
        FilterWheelContract,
        LightContract,
        LoadCellContract,
        StageContract,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["CameraContract", "FilterWheelContract", "LightContract", "LoadCellContract", "StageContract"]

pytest.register_assert_rewrite("rigs.contracts.devices")
