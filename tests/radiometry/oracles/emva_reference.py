"""Run the EMVA 1288 reference implementation on stored frames; a process of its own keeps its licence out of ours.

Usage: ``python emva_reference.py FOLDER``; its ``images.json`` holds {kind: {exposure in ns: {photons: [.npy files]}}}.
The last line of the output is a JSON object.
"""

import json
import logging
import sys
from pathlib import Path

import numpy as np

PARTS = ("row", "col", "pixel")


def main(folder: Path) -> None:
    # The package calls a function that NumPy 2 no longer has.
    np.asfarray = lambda a, dtype=float: np.asarray(a, dtype)  # noqa: NPY201
    from emva1288.process.data import Data1288
    from emva1288.process.loader import LoadImageData
    from emva1288.process.results import Results1288

    images = {
        kind: {float(t): {float(p): files for p, files in photons.items()} for t, photons in exposures.items()}
        for kind, exposures in json.loads((folder / "images.json").read_text()).items()
    }
    logging.disable(logging.CRITICAL)
    data = Data1288(LoadImageData(images, path=str(folder), fload=np.load).data)
    results = Results1288(data.data)
    linearity = results.linearity()
    sys.stdout.write(
        json.dumps(
            {
                "mean_dn": data.data["temporal"]["u_y"].tolist(),
                "variance_dn2": data.data["temporal"]["s2_y"].tolist(),
                "k_dn_per_e": float(results.K),
                "sigma_d_e": float(results.sigma_d),
                "saturation_index": int(results.index_u_ysat),
                "lowest_percent": float(linearity["linearity_error_min"]),
                "highest_percent": float(linearity["linearity_error_max"]),
                "dsnu_e": float(results.DSNU1288),
                "prnu_percent": float(results.PRNU1288),
                **{f"dsnu_{part}_e": float(getattr(results, f"DSNU1288_{part}")) for part in PARTS},
                **{f"prnu_{part}_percent": float(getattr(results, f"PRNU1288_{part}")) for part in PARTS},
                "saturation_capacity_e": float(results.u_e_sat),
                "threshold_e": float(results.u_e_min),
                "snr_max_db": float(results.SNR_max_dB()),
                "dynamic_range_db": float(results.DR_dB()),
                "dark_current_e_per_s": float(results.u_I_mean),
            }
        )
        + "\n"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
