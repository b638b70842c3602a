"""What all path tracers of a finger have in common: how long paths are, when chance ends them, how near rays start."""

from typing import Final

MAX_DEPTH: Final = 30
"""Longest path in surfaces; at 10 the painted bands lose 30 % of their light."""

ROULETTE_DEPTH: Final = 6
"""Paths of more surfaces end by chance."""

LARGEST_SURVIVAL: Final = 0.95
"""Largest chance of a path to go on once chance may end it."""

LIFT_MM: Final = 2e-3
"""Rays leave a surface by this much, and stop before the inner face by as much more as its mesh lies off its map."""

NEWTON_STEPS: Final = 3
"""In single precision: from the undeformed face they meet Snell's law to 1e-6 even at a bending radius of 50 mm."""

SMALLEST_COS_AIR: Final = 0.02
"""Nearer to grazing, rays that leave the inner face keep no further away from it."""
