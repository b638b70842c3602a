"""Stages that press an indenter into the pad, one file for each protocol; a driver is named in the rig file."""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.stages.grbl import GrblStage
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["GrblStage"]
