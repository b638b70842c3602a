"""What every camera, filter wheel and light must do: the same tests for all implementations and users' own rigs.

On a rig of your own: ``pytest -p rigs.contracts.plugin --pyargs rigs.contracts --rig my-rig.toml``.
"""

from data_schemas.errors import MissingExtraError

try:
    import pytest
except ImportError as error:
    raise MissingExtraError(
        f"the contracts of the devices are tests and need pytest ({error}); install it with pip install pytest"
    ) from error

pytest.register_assert_rewrite("rigs.contracts.camera", "rigs.contracts.filter_wheel", "rigs.contracts.light")
