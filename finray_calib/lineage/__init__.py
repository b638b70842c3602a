"""Where a stored number comes from: its tree of inputs, whether each file is unchanged, and how to compute it again.

Every file is hashed again and compared with the SHA-256 that the records hold; a record is replayed by running its
command into a temporary folder and comparing the numbers.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.lineage._trace import FolderCheck, Replayed, Traced, Tracer, findings, replay, verify_folder
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["FolderCheck", "Replayed", "Traced", "Tracer", "findings", "replay", "verify_folder"]
