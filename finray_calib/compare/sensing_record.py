"""The error in sensing space of every candidate, from one normal map."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import Interval, SensingRow
from data_schemas.compare import SensingError as SensingRecord
from data_schemas.sensing import NormalMapRecord
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.input_draws import Drawn
from finray_calib.compare.normal_map_record import check_senses, normal_map_of
from finray_calib.compare.sensing_error import SensingError, sensing_error
from finray_calib.compare.stopping_rule import ends

Floats = NDArray[np.float64]
DRAWS = 40
"""Of the inputs: whole images are sensed; the ends of an interval of 40 draws are its second smallest and largest."""


def sensing_record(
    comparison: Comparison,
    normal_map: NormalMapRecord,
    capture: TactileCapture,
    candidates: dict[str, Floats],
    block_px: int,
    conditioned: Drawn | None,
) -> SensingRecord:
    """Sense every candidate image and the capture with one map, over the headline region.

    Parameters
    ----------
    comparison
        Both sides.
    normal_map
        Of the capture's sensor.
    capture
        Refused where the map was taught by another encoding.
    candidates
        Name -> image (H, W, 3) at the level of the capture.
    block_px
        Side of the blocks that the images are means of.
    conditioned
        Draws of the inputs, for the interval of the simulation; without them an interval has no width.

    Raises
    ------
    CompareError
        The map belongs to another encoding or size.
    """
    check_senses(normal_map, capture)
    senses = normal_map_of(normal_map)
    captured, layers, k = comparison.captured, comparison.layers, comparison.best_exposure
    rest = k * layers.rgb(layers.no_contact)
    mm_per_px = normal_map.mm_per_px * block_px

    def sensed(image: Floats, without: Floats) -> SensingError:
        used = comparison.used[-1]
        return sensing_error(senses, image, without, captured.contact, captured.no_contact, used, mm_per_px)

    found = {name: sensed(i, rest if name == "simulation" else captured.no_contact) for name, i in candidates.items()}
    spread = [] if conditioned is None else [sensed(*pair) for pair in _drawn_images(comparison, conditioned)]
    scores = normal_map.held_out_explained_rel
    return SensingRecord(
        normal_map=normal_map.name,
        presses=normal_map.presses,
        held_out_explained_rel=Interval(
            estimate=float(np.median(scores)), low95=float(scores.min()), high95=float(scores.max())
        ),
        outside_share_simulated=found["simulation"].outside_share_simulated,
        outside_share_captured=found["simulation"].outside_share_captured,
        mm_per_px_u_rel=normal_map.mm_per_px_u_rel,
        rows=tuple(_row(name, error, spread if name == "simulation" else []) for name, error in found.items()),
    )


def _drawn_images(comparison: Comparison, drawn: Drawn) -> list[tuple[Floats, Floats]]:
    """Return the render with and without contact for the first draws."""
    layers, weights = comparison.layers, drawn.weights[:DRAWS]
    exposure = comparison.exposure_of(drawn.matrix[:DRAWS])
    count = layers.matrix.shape[1]
    poses = [layers.pose_names.index(n) for n in (comparison.inputs.pose_names if comparison.inputs else ())]
    contact = np.concatenate([layers.contact, *(layers.pose[n] for n in poses)], axis=-1)
    return [
        (k * (contact @ w.T), k * (layers.no_contact @ w[:, :count].T)) for k, w in zip(exposure, weights, strict=True)
    ]


def _row(name: str, error: SensingError, spread: list[SensingError]) -> SensingRow:
    """Return the record of one candidate."""
    fields = ("normal_angle_mean_deg", "normal_angle_p95_deg", "depth_rms_mm")
    return SensingRow.model_validate(
        {"candidate": name, **{f: _interval(getattr(error, f), [getattr(s, f) for s in spread]) for f in fields}}
    )


def _interval(best: float, draws: list[float]) -> Interval:
    """Return the interval of some draws; the value itself where there are none."""
    low, high = ends(np.array(draws)) if draws else (best, best)
    return Interval(estimate=float(np.median(draws)) if draws else best, low95=float(low), high95=float(high))
