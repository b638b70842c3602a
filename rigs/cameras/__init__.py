"""Drive cameras: raw counts with the exposure that was asked for and read back.

One file per make or protocol, named after it, with ``open_camera(settings, folder)`` and, where devices can be looked
for, ``found()``. What is offered here serves more than one driver: GenICam cameras by whichever library they are
reached, and images in files.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.cameras._genicam import DeliveredFrame, Device, Features, GenicamCamera
    from rigs.cameras._image_files import (
        decoded_picture,
        read_content,
        read_dng,
        read_picture,
        read_plain_counts,
        read_raw,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "DeliveredFrame",
    "Device",
    "Features",
    "GenicamCamera",
    "decoded_picture",
    "read_content",
    "read_dng",
    "read_picture",
    "read_plain_counts",
    "read_raw",
]
