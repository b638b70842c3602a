"""Say so where another package of the same name stands in the way of one of this project's."""

from importlib.util import find_spec
from pathlib import Path

NEIGHBOURS = ("data_schemas", "rigs", "sim")


def require_own_packages(root: Path, names: tuple[str, ...] = NEIGHBOURS) -> None:
    """Refuse a package of one of these names that does not stand in `root`, the folder that holds finray_calib.

    Raises
    ------
    ImportError
        One is missing, or is another package of that name.
    """
    for name in names:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ImportError(
                f"finray_calib needs its package '{name}' beside it in {root}; install finray-calib again"
            )
        if Path(spec.origin).resolve().parent.parent != root.resolve():
            raise ImportError(
                f"finray_calib needs its own package '{name}', but Python finds another package of this name at "
                f"{spec.origin}; rename "
                "that one, start Python from another folder, or give finray-calib an environment of its own"
            )
