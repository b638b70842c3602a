"""A writer of containers of tactile captures that needs numpy only, and nothing of finray.

    python examples/tactile-captures/write_captures.py my-set.zip

It writes two made-up presses of a ball of 6 mm; put your own images and numbers in their place. The container is
described in docs/reference/tactile-captures.md.
"""

import hashlib
import io
import json
import sys
import zipfile

import numpy as np


def add_capture(archive, name, images, facts):
    """Add a capture: images of uint16 counts (H, W, 3), and what is known of them."""
    buffer = io.BytesIO()
    np.savez(buffer, **images)
    digest = hashlib.sha256(buffer.getvalue()).hexdigest()
    array_file = f"{name}.capture.{digest[:12]}.npz"
    named = {key: {"array": key, "shape": list(i.shape), "dtype": i.dtype.str} for key, i in images.items()}
    envelope = {
        "kind": "TactileCapture",
        "schema_version": 4,
        "array_file": {"file": array_file, "sha256": digest},
        "record": {"name": name, **named, **facts},
    }
    text = json.dumps(envelope, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    envelope["content_sha256"] = hashlib.sha256(text.encode()).hexdigest()
    archive.writestr(array_file, buffer.getvalue())
    archive.writestr(f"{name}.capture.json", json.dumps(envelope, indent=1, ensure_ascii=False))


def made_up_press(row, column, rng, shape=(120, 160), radius=20.0):
    """Return contact, no contact and a repeat of it: a ball that shades red to one side and blue to the other."""
    rows, columns = np.indices(shape)
    down, along = (rows - row) / radius, (columns - column) / radius
    slope = np.stack([along, 0.3 * down, -along], axis=-1) * (np.hypot(down, along) < 1.0)[..., None]
    pad = np.stack([120.0 + 0.1 * columns, 150.0 + 0.1 * rows, np.full(shape, 140.0)], axis=-1)
    images = (pad * (1.0 + 0.4 * slope), pad, pad)
    names = ("contact", "no_contact", "repeat_no_contact")
    return {n: np.rint(i + rng.standard_normal(i.shape)).astype("<u2") for n, i in zip(names, images, strict=True)}


def main(path):
    """Write two presses."""
    rng = np.random.default_rng(1)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, row, column in (("press-1", 60.0, 80.0), ("press-2", 50.0, 95.0)):
            facts = {
                "layout": "RGB",
                "encoding": "unknown",
                "bit_depth": 8,
                "black_level_dn": 0.0,
                "exposure_s": None,
                "light_angle_deg": None,
                "indenter": {"shape": "ball", "radius_mm": 3.0, "depth_mm": None, "position_mm": None},
                "contact_circle": {"row_px": row, "column_px": column, "radius_px": 20.0},
                "contact_told_by": "label",
                "mm_per_px": 0.1,
                "source": "made up",
                "licence": "CC0-1.0",
                "missing": [{"what": "the force", "lost": "stiffness of the gel cannot be checked"}],
            }
            add_capture(archive, name, made_up_press(row, column, rng), facts)


if __name__ == "__main__":
    main(sys.argv[1])
