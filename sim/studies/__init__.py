"""Design studies: one finger, what changes, and what is computed at each point; on one machine or on many.

A plan (TOML, `read_plan`; `SHIPPED_PLANS` come with the package) becomes points (`study_points`), each a whole design.
`run_study` presses, renders and measures them in worker processes of Dask, computes once what points share, keeps what
is finished, and continues where it was interrupted. A point is stored as soon as it is computed; one that fails is
stored with its reason, and the others are computed. `run_dataset` draws, presses and renders the samples of a data set
for learning in the same way, a shard at a time.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim.studies._dataset import (
        DatasetTask,
        PlannedShard,
        pixel_places_mm,
        planned_shards,
        run_dataset,
        sampled_light,
        sampled_press,
        shard_file,
    )
    from sim.studies._engine import run_study
    from sim.studies._point import (
        SHIPPED_PLANS,
        STUDY_FOLDERS,
        PlannedPoint,
        StudyPaints,
        StudyTask,
        design_folder,
        point_code,
        point_file,
        read_plan,
        study_points,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "SHIPPED_PLANS",
    "STUDY_FOLDERS",
    "DatasetTask",
    "PlannedPoint",
    "PlannedShard",
    "StudyPaints",
    "StudyTask",
    "design_folder",
    "pixel_places_mm",
    "planned_shards",
    "point_code",
    "point_file",
    "read_plan",
    "run_dataset",
    "run_study",
    "sampled_light",
    "sampled_press",
    "shard_file",
    "study_points",
]
