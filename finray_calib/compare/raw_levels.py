"""Whether the raw counts of a capture fit its recorded bit depth and black level."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture

Counts = NDArray[np.uint16]
#: Pixels that must stand at one highest level, and how many times the level below it, to be a clipped image.
_LEAST_PILE, _PILE_TIMES = 50, 5
#: A pile at a level that is close to the typical one is a flat image, not a clipped one.
_PILE_ABOVE_MEDIAN = 1.2
_DARKEST = 0.01
_TIMES_NOISE = 5.0


def level_findings(capture: TactileCapture) -> list[tuple[bool, str]]:
    """Return (whether to refuse, text) for counts that contradict the recorded bit depth or black level.

    * counts above full scale 2^bits - 1;
    * many pixels at one highest level below full scale: data of a smaller depth, or clipped by a program, so that
      clipped pixels would pass for light;
    * all counts multiples of a number: a smaller depth shifted up;
    * the darkest per cent of the no-contact image below the black level by more than five times its noise (known from
      the repeat).
    """
    images = {"contact": capture.contact, "no-contact": capture.no_contact}
    if capture.repeat_no_contact is not None:
        images["repeated no-contact"] = capture.repeat_no_contact
    full_scale_dn = 2**capture.bit_depth - 1
    findings = []
    for name, counts in images.items():
        findings += _depth_findings(f"the {name} image of {capture.name}", counts, full_scale_dn, capture.bit_depth)
    return findings + _black_findings(capture)


def _depth_findings(name: str, counts: Counts, full_scale_dn: int, bits: int) -> list[tuple[bool, str]]:
    """Compare the highest and the common levels with the recorded depth."""
    highest = int(counts.max())
    if highest > full_scale_dn:
        return [(True, f"{name} holds {highest} DN, above the full scale of {bits} bit ({full_scale_dn} DN): {_MEND}")]
    levels, pixels = np.unique(counts, return_counts=True)
    findings = []
    step = int(np.gcd.reduce(levels))
    if step > 1 and len(levels) > 2:
        findings.append(
            (
                False,
                f"{name} holds multiples of {step} DN only, as data of fewer than {bits} bit that were shifted up: "
                f"pixels clipped at {full_scale_dn // step * step} DN are not recognised; {_MEND}",
            )
        )
    piled = len(levels) > 2 and pixels[-1] >= max(_LEAST_PILE, _PILE_TIMES * pixels[-2])
    if highest < full_scale_dn and piled and highest > _PILE_ABOVE_MEDIAN * np.median(counts):
        smaller = f", as in data of {(highest + 1).bit_length() - 1} bit" if (highest & (highest + 1)) == 0 else ""
        findings.append(
            (
                True,
                f"{pixels[-1]} values of {name} stand at exactly {highest} DN{smaller}, none above, and full scale is "
                f"recorded as {full_scale_dn} DN ({bits} bit): they are clipped and would pass for light; {_MEND}",
            )
        )
    return findings


_MEND = "record the bit depth of the camera's own counts"


def _black_findings(capture: TactileCapture) -> list[tuple[bool, str]]:
    """Compare the darkest pixels with the recorded black level."""
    if capture.repeat_no_contact is None:
        return []
    first, second = (image.astype(np.float64) for image in (capture.no_contact, capture.repeat_no_contact))
    dark = first + second <= np.quantile(first + second, _DARKEST)
    level_dn = float((first[dark] + second[dark]).mean() / 2)
    noise_dn = float((first[dark] - second[dark]).std()) / np.sqrt(2)
    below_dn = capture.black_level_dn - level_dn
    if below_dn <= _TIMES_NOISE * noise_dn + 1.0:
        return []
    return [
        (
            True,
            f"the darkest per cent of the no-contact image of {capture.name} lies at {level_dn:.1f} DN (noise "
            f"{noise_dn:.1f} DN), below the recorded black level of {capture.black_level_dn:g} DN: light cannot be "
            "negative; record the black level of a dark frame with the same settings",
        )
    ]
