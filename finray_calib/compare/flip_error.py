"""The difference that people see when they flip between two displayed images (FLIP), by its makers' own program."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import MissingExtraError
from finray_calib.compare.regions import usable_pixels

Floats = NDArray[np.float64]
#: A 0.7 m wide screen of 3840 pixels seen from 0.7 m: the default of FLIP's makers.
PIXELS_PER_DEGREE = 67.0


def flip_mean(
    reference_srgb: Floats, test_srgb: Floats, mask: NDArray[np.bool_], pixels_per_deg: float = PIXELS_PER_DEGREE
) -> float:
    """Return the mean LDR-FLIP over a region, 0 (no visible difference) to 1.

    A pixel that is not finite in one image is black in both, so that it adds no difference of its own.

    Parameters
    ----------
    reference_srgb, test_srgb : ndarray, shape (H, W, 3)
        Displayed images in 0..1, see `displayed_image`; the capture is the reference.
    mask : ndarray of bool, shape (H, W)
    pixels_per_deg : float
        Of visual angle.

    Raises
    ------
    CompareError
        If shapes differ or no pixel is usable.
    MissingExtraError
        The package flip-evaluator is not installed.

    References
    ----------
    P. Andersson et al., Proc. ACM Comput. Graph. Interact. Tech. 3 (2020) 15.
    """
    used = usable_pixels(mask, reference_srgb, test_srgb)
    try:
        import flip_evaluator
    except ImportError:
        raise MissingExtraError(
            "FLIP needs the package flip-evaluator: pip install 'finray-calib[flip]', or do without this row"
        ) from None
    finite = np.asarray(np.isfinite(reference_srgb + test_srgb).all(axis=2))[..., None]
    reference, test = (np.where(finite, image, 0.0).astype(np.float32) for image in (reference_srgb, test_srgb))
    error, _, _ = flip_evaluator.evaluate(
        reference, test, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False,
        parameters={"ppd": pixels_per_deg},
    )  # fmt: skip
    return float(np.asarray(error, dtype=np.float64).reshape(used.shape)[used].mean())
