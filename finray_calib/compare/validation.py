"""Validation statement per part of the region and channel, after ASME V&V 20, with the area validation metric."""

from typing import Final, Literal

import numpy as np

from data_schemas.compare import ValidationCell
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.input_draws import WALLS, Inputs

DRAWS = 2000
COVERAGE_FACTOR = 2.0
_CHANNELS: Final[tuple[Literal["red", "green", "blue"], ...]] = ("red", "green", "blue")
_CONTACT = 1


def validation_cells(comparison: Comparison, inputs: Inputs, rng: np.random.Generator) -> tuple[ValidationCell, ...]:
    """Compare mean levels of 3 x 3 parts of the headline region, in each channel.

    With the simulated and captured means S and D, E = S - D and u_val^2 = u_num^2 + u_input^2 + u_D^2: render noise,
    paints with camera and pose as known before the capture, and noise with drift of the capture. The model's error lies
    in E +- 2 u_val; where abs(E) <= 2 u_val it is within the validation uncertainty. The area metric is the area
    between the distribution of S over its inputs and the captured D, its parts above and below D apart.

    References
    ----------
    ASME V&V 20-2009, sections 1 and 6; S. Ferson, W. L. Oberkampf, L. Ginzburg, Comput. Methods Appl. Mech. Eng. 197
    (2008) 2408.
    """
    levels, exposure, drawn = comparison.levels, comparison.exposure, inputs.draw(DRAWS, rng)
    if levels is None:
        return ()
    walls = drawn.only(WALLS)
    steady = Inputs(inputs.layers, inputs.pose_sd_mm, None, None).draw(DRAWS, rng)
    ratios = {name: levels.log_ratio(d, exposure)[:, _CONTACT] for name, d in (("walls", walls), ("inputs", steady))}
    simulated = np.exp(ratios["inputs"])
    error = np.exp(levels.log_ratio(inputs.best(), exposure)[0, _CONTACT]) - 1.0
    render = levels.render_variance[_CONTACT]
    camera = levels.noise_variance[_CONTACT] - render
    # the render's noise is known relative to the simulated level, all else is stated relative to the captured one
    u_numerical = (1.0 + error) * np.sqrt(render + ratios["walls"].var(axis=0, ddof=1))
    u_data = np.sqrt(camera + drawn.log_drift.var(ddof=1))
    u_input = simulated.std(axis=0, ddof=1)
    u_validation = np.sqrt(u_numerical**2 + u_input**2 + u_data**2)
    return tuple(
        ValidationCell(
            row=row,
            column=column,
            channel=channel,
            pixels=int(levels.pixels[i]),
            error_rel=float(error[c, i]),
            u_numerical_rel=float(u_numerical[c, i]),
            u_input_rel=float(u_input[c, i]),
            u_data_rel=float(u_data[c, i]),
            u_validation_rel=float(u_validation[c, i]),
            within=bool(abs(error[c, i]) <= COVERAGE_FACTOR * u_validation[c, i]),
            area_too_bright_rel=float(np.maximum(simulated[:, c, i] - 1.0, 0.0).mean()),
            area_too_dark_rel=float(np.maximum(1.0 - simulated[:, c, i], 0.0).mean()),
        )
        for i, (row, column) in enumerate(levels.places)
        for c, channel in enumerate(_CHANNELS)
    )
