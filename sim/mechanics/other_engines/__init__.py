"""Other programs for the same press: decks, CalculiX in a separate process, results of Abaqus.

A deck holds the same mesh, materials and push as our own engine, so that the programs differ in contact and elements
only. `finger_deck` writes one for Abaqus or CalculiX, `press_finger_calculix` runs CalculiX on it, and
`pressed_by_abaqus` reads the results of a user's Abaqus; both give the `PressedFinger` that our own press gives.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim.mechanics.other_engines._abaqus import pressed_by_abaqus, read_fil
    from sim.mechanics.other_engines._calculix import calculix_notes, calculix_version, press_finger_calculix
    from sim.mechanics.other_engines._deck import finger_deck
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "calculix_notes",
    "calculix_version",
    "finger_deck",
    "press_finger_calculix",
    "pressed_by_abaqus",
    "read_fil",
]
