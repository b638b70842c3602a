"""Which finger a product is of: what its light depends on, part by part, as checksums."""

import hashlib
import json
from typing import Any, Final

from pydantic import Field

from data_schemas.design import FingerDesign
from data_schemas.model import Model

#: Fields that are no part of the finger: what is varied or set in a session, how finely it is computed, and words.
_LEFT_OUT: Final = {
    "light": {"angle_deg"},
    "second_light": {"angle_deg"},
    # a sweep sees its probe points along the normal of the pad: of the camera it has the response only
    "camera": {
        "width_px",
        "height_px",
        "bit_depth",
        "field_of_view_deg",
        "calibration",
        "response_at_led_uncertainty_rel",
    },
    "indenter": {"depth_mm"},
}
VERSION: Final = 2
"""Of what is hashed: another field of a part, or another way to hash, is another version. Version 1 left out fields at
their default, so that after a change of a default different fingers could look alike."""
_PARTS: Final = (
    "pad", "coating", "light", "second_light", "enclosure", "mirror", "camera", "indenter", "skeleton", "mechanics",
)  # fmt: skip


class FingerIdentity(Model):
    """A finger with its indenter, without the angle of its light and the depth of the press."""

    version: int = Field(default=1, description="of what is hashed; parts of two versions cannot be compared")
    name: str
    depth_mm: float = Field(description="of the press; another depth is another press of the same finger")
    parts: dict[str, str] = Field(description="part of the design -> SHA-256 of its values")

    def differs_in(self, other: "FingerIdentity") -> tuple[str, ...]:
        """Return the parts that are not those of another finger."""
        names = sorted(self.parts.keys() | other.parts.keys())
        return tuple(name for name in names if self.parts.get(name) != other.parts.get(name))


def finger_identity(design: FingerDesign) -> FingerIdentity:
    """Return which finger a design describes; names, origins, materials in words and meshes do not count.

    All values count, those at their default too. Files count by their name: an STL of an indenter that was changed and
    kept its name is not noticed.
    """
    parts = {}
    for name in _PARTS:
        part = getattr(design, name)
        given: Any = None if part is None else part.model_dump(mode="json")
        if given is not None:
            given = {key: value for key, value in given.items() if key not in _LEFT_OUT.get(name, set())}
        parts[name] = hashlib.sha256(json.dumps(given, sort_keys=True).encode()).hexdigest()
    return FingerIdentity(version=VERSION, name=design.name, depth_mm=design.indenter.depth_mm, parts=parts)
